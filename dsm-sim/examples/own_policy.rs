//! Verifying a variation of one's own: a replacement policy, with every invariant checked after every step.
//!
//! ```text
//! cargo run --release -p dsm-sim --example own_policy               # 200 seeds hold
//! cargo run --release -p dsm-sim --example own_policy -- --wrong    # one with a fault is found out
//! ```

use std::process::ExitCode;

use clap::Parser;
use dsm_core::id::SlotId;
use dsm_core::replacement::Replacement;
use dsm_core::storage::SlotEntry;
use dsm_sim::cluster::Checks;
use dsm_sim::fault::Chances;
use dsm_sim::paging::{Config, ConfigError, Memory, World};
use dsm_sim::time::ms;
use dsm_sim::verify;

/// Tries a replacement policy on a small cluster in which everything goes wrong that can.
#[derive(Debug, Parser)]
struct CommandLine {
    /// Let the policy have a fault: it loses sight of every twentieth page
    #[arg(long)]
    wrong: bool,
    /// The first seed
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// How many seeds are tried
    #[arg(long, default_value_t = 200)]
    seeds: u64,
}

/// The page that came last leaves first: best for a scan, worst for nearly everything else.
#[derive(Debug, Default)]
struct LastInFirstOut {
    stack: Vec<SlotId>,
    pages: u32,
    is_wrong: bool,
}

impl Replacement for LastInFirstOut {
    fn handle_resident(&mut self, _slots: &mut [SlotEntry], slot: SlotId) {
        self.pages += 1;
        if !(self.is_wrong && self.pages.is_multiple_of(20)) {
            self.stack.push(slot);
        }
    }

    fn handle_reference(&mut self, _slots: &mut [SlotEntry], _slot: SlotId) {}

    fn choose_victim(&mut self, _slots: &mut [SlotEntry]) -> Option<SlotId> {
        self.stack.pop()
    }
}

fn main() -> ExitCode {
    let arguments = CommandLine::parse();
    match arguments.run() {
        Ok(held) => {
            println!("{held} seeds held, every invariant checked after every step");
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

impl CommandLine {
    fn run(&self) -> Result<u64, String> {
        let mut memory = small_and_eventful().and_then(Memory::new).map_err(|error| error.to_string())?;
        let is_wrong = self.wrong;
        let outcome = verify::seeds(self.seed..self.seed + self.seeds, |seed| {
            let policy = |_node, _seed| LastInFirstOut { is_wrong, ..LastInFirstOut::default() };
            let report = World::with_policy(&mut memory, seed, policy).run();
            match report.total().failed_touches {
                0 => Ok(()),
                failed => Err(format!("{failed} touches ended without their page")),
            }
        });
        outcome.map_err(|failed| {
            let wrong = if self.wrong { " --wrong" } else { "" };
            let command = "cargo run --release -p dsm-sim --example own_policy --";
            format!("{failed}\nreplay it: {command} --seeds 1 --seed {}{wrong}", failed.seed)
        })
    }
}

/// Four nodes with few slots, links that lose and double, and nodes that stall and are cut off.
fn small_and_eventful() -> Result<Config, ConfigError> {
    let mut config = Config::new(4, 32)?;
    config.slots = 3;
    config.checks = Checks::EveryStep;
    config.network = config.network.with_links(|link| (link.loss_ppm, link.duplicate_ppm) = (50_000, 50_000));
    config.faults.chances = Chances {
        stall_every_ns: ms(20),
        stall_ns: ms(5),
        cut_every_ns: ms(100),
        heal_after_ns: ms(10),
        ..Chances::NONE
    };
    Ok(config)
}
