//! A paging cluster in virtual time, from the command line.

use std::io::{self, Write};
use std::process::ExitCode;

use clap::{Parser, ValueEnum};
use dsm_core::replacement::PolicyKind;
use dsm_sim::cluster::Step;
use dsm_sim::fault::Chances;
use dsm_sim::network::Network;
use dsm_sim::paging::{Config, ConfigError, Memory, Workload, World};
use dsm_sim::time::ms;
use dsm_sim::verify;

/// Runs a paging cluster in virtual time and prints what it did.
///
/// The same arguments and seed give the same run, event for event.
#[derive(Debug, Parser)]
#[command(after_help = "\
Examples:
  cargo run --release -p dsm-sim --example cluster -- --nodes 64 --loss 10 --seed 7
  cargo run --release -p dsm-sim --example cluster -- --nodes 31 --stores 1 --network gigabit --workload zipf
  cargo run --release -p dsm-sim --example cluster -- --nodes 64 --replicas 2 --loss 10 --crashes 20 --seeds 1000
  cargo run --release -p dsm-sim --example cluster -- --nodes 2 --touches 20 --pages 16 --trace")]
struct CommandLine {
    /// Nodes with threads
    #[arg(long, default_value_t = 16)]
    nodes: u16,
    /// Nodes that only own pages; without any, those with threads own them
    #[arg(long, default_value_t = 0)]
    stores: u16,
    /// Threads of a node
    #[arg(long, default_value_t = 2)]
    threads: u8,
    /// Pages of 16 KB
    #[arg(long, default_value_t = 1024)]
    pages: u32,
    /// Slots of a node; by default one for each eighth page
    #[arg(long)]
    slots: Option<u32>,
    /// Copies of each page
    #[arg(long, default_value_t = 1)]
    replicas: u8,
    /// Bytes of a page that one message carries; 0: all
    #[arg(long, default_value_t = 0, value_name = "BYTES")]
    message_room: u32,
    /// Pages that a thread touches
    #[arg(long, default_value_t = 1000)]
    touches: u32,
    /// Which pages are touched
    #[arg(long, value_enum, default_value_t = Touched::Uniform)]
    workload: Touched,
    /// Which page leaves: random, fifo, clock
    #[arg(long, default_value = "random")]
    policy: PolicyKind,
    /// The network
    #[arg(long, value_enum, default_value_t = Speed::HundredGigabit)]
    network: Speed,
    /// Messages lost, in per cent
    #[arg(long, default_value_t = 0)]
    loss: u32,
    /// Messages doubled, in per cent
    #[arg(long, default_value_t = 0)]
    duplicates: u32,
    /// Mean time between crashes of a node, in milliseconds; 0: none
    #[arg(long, default_value_t = 0)]
    crashes: u64,
    /// After how many milliseconds a crashed node starts again; 0: never
    #[arg(long, default_value_t = 0)]
    restart_ms: u64,
    /// Decides all that chance decides
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Print everything that happens instead of the report
    #[arg(long)]
    trace: bool,
    /// Run so many seeds, from --seed on, and print the first that fails
    #[arg(long, value_name = "COUNT")]
    seeds: Option<u64>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Touched {
    Uniform,
    Zipf,
    Window,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Speed {
    Gigabit,
    HundredGigabit,
    Perfect,
}

fn main() -> ExitCode {
    let arguments = CommandLine::parse();
    let memory = arguments.config().and_then(Memory::new);
    let outcome = match memory {
        Ok(memory) => arguments.run(memory),
        Err(error) => Err(error.to_string()),
    };
    if let Err(error) = outcome {
        eprintln!("error: {error}");
        return ExitCode::FAILURE;
    }
    ExitCode::SUCCESS
}

impl CommandLine {
    fn config(&self) -> Result<Config, ConfigError> {
        let mut config = Config::with_stores(self.nodes, self.stores, self.pages)?;
        config.threads = self.threads;
        config.touches = self.touches;
        config.slots = self.slots.unwrap_or(config.slots);
        let placement = config.node.placement.with_replicas(self.replicas);
        config.node.placement = placement.map_err(ConfigError::Placement)?;
        (config.message_room, config.node.fragments) = (self.message_room, self.message_room > 0);
        config.workload = match self.workload {
            Touched::Uniform => Workload::Uniform,
            Touched::Zipf => Workload::Zipf { exponent: 1.0 },
            Touched::Window => Workload::Window { pages: config.slots, touches_a_page: 10 },
        };
        let network = match self.network {
            Speed::Gigabit => Network::gigabit(),
            Speed::HundredGigabit => Network::hundred_gigabit(),
            Speed::Perfect => Network::PERFECT,
        };
        config.network = network.with_links(|link| {
            link.loss_ppm = self.loss.saturating_mul(10_000);
            link.duplicate_ppm = self.duplicates.saturating_mul(10_000);
        });
        config.faults.chances = Chances {
            crash_every_ns: ms(self.crashes),
            restart_after_ns: ms(self.restart_ms),
            ..Chances::NONE
        };
        Ok(config)
    }

    fn run(&self, mut memory: Memory) -> Result<(), String> {
        if self.trace {
            let mut world = World::new(&mut memory, self.policy, self.seed);
            return print_trace(&mut world).or_else(no_reader).map_err(|error| error.to_string());
        }
        let mut run = |seed| World::new(&mut memory, self.policy, seed).run();
        let Some(count) = self.seeds else {
            println!("{}", run(self.seed));
            return Ok(());
        };
        let mut steps = 0;
        let held = verify::seeds(self.seed..self.seed.saturating_add(count), |seed| {
            steps += run(seed).steps;
            Ok(())
        });
        let held = held.map_err(|failed| {
            format!("{failed}\nreplay it with the same arguments, --seed {} and without --seeds", failed.seed)
        })?;
        println!("{held} seeds held, {steps} events");
        Ok(())
    }
}

/// That nobody reads any more, as with `| head`, is no error.
fn no_reader(error: io::Error) -> io::Result<()> {
    if error.kind() == io::ErrorKind::BrokenPipe { Ok(()) } else { Err(error) }
}

/// Prints everything that happens in a world, a line each, for as long as somebody reads it.
fn print_trace(world: &mut World<'_>) -> io::Result<()> {
    let mut out = io::stdout().lock();
    while let Some(Step { number, at, node, what }) = world.step() {
        writeln!(out, "{number:9} {at} {node}: {what:?}")?;
    }
    Ok(())
}
