//! Variations of one's own run, and wrong ones are found out by the name of the promise they break.

use dsm_core::id::SlotId;
use dsm_core::replacement::{Fifo, Replacement};
use dsm_core::storage::SlotEntry;
use dsm_sim::cluster::Checks;
use dsm_sim::paging::{Config, Memory, World};
use dsm_sim::verify::{self, Counterexample};

/// `fifo`, with a fault of its own.
#[derive(Debug)]
struct Variation {
    fifo: Fifo,
    fault: Fault,
    pages: u32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    None,
    /// Loses sight of every tenth page.
    Forgets,
    /// Finds no victim every tenth time.
    Hesitates,
}

impl Variation {
    fn is_tenth(&mut self) -> bool {
        self.pages += 1;
        self.pages.is_multiple_of(10)
    }
}

impl Replacement for Variation {
    fn handle_resident(&mut self, slots: &mut [SlotEntry], slot: SlotId) {
        if self.fault != Fault::Forgets || !self.is_tenth() {
            self.fifo.handle_resident(slots, slot);
        }
    }

    fn handle_reference(&mut self, _slots: &mut [SlotEntry], _slot: SlotId) {}

    fn choose_victim(&mut self, slots: &mut [SlotEntry]) -> Option<SlotId> {
        if self.fault == Fault::Hesitates && self.is_tenth() { None } else { self.fifo.choose_victim(slots) }
    }
}

fn hold(fault: Fault) -> Result<u64, Counterexample> {
    let mut config = Config::new(4, 32).unwrap();
    (config.slots, config.checks) = (3, Checks::EveryStep);
    let mut memory = Memory::new(config).unwrap();
    verify::seeds(0..20, |seed| {
        let policy = |_, _| Variation { fifo: Fifo::new(), fault, pages: 0 };
        let report = World::with_policy(&mut memory, seed, policy).run();
        if report.total().failed_touches == 0 { Ok(()) } else { Err("a page was not had".to_owned()) }
    })
}

#[test]
fn a_right_variation_holds() {
    assert_eq!(hold(Fault::None), Ok(20));
}

#[test]
fn a_wrong_variation_is_found_out_and_its_seed_fails_again() {
    for fault in [Fault::Forgets, Fault::Hesitates] {
        let found = hold(fault).unwrap_err();
        assert!(found.what.contains("NO_LOST_WAITER"), "{fault:?}: {found}");
        assert_eq!(hold(fault).unwrap_err(), found);
    }
}
