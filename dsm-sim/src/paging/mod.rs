//! A paging cluster: `dsm-core`'s state machines, driven in virtual time.

mod config;
mod mapping;
mod member;
mod packet;
mod report;
mod stray;
mod thread;
mod workload;
mod world;

pub use config::{Config, ConfigError, Costs};
pub use member::Member;
pub use packet::{Packet, Task};
pub use report::{Counts, NodeReport, Report};
pub use workload::Workload;
pub use world::{Memory, World};
