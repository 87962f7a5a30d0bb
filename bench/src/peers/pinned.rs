//! Keeping to one core.

use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};

/// While it lives, this thread and what it starts keep to one core: whoever is compared runs on the same one.
#[derive(Debug)]
pub(crate) struct Pinned {
    /// The cores allowed before; `None` when the system does not say or refused.
    before: Option<CpuSet>,
}

impl Pinned {
    /// Keeps to the last core that is allowed: most of what else a system does begins at the first.
    pub(crate) fn to_one_core() -> Self {
        let before = sched_getaffinity(None).ok().filter(|allowed| {
            let last = (0..CpuSet::MAX_CPU).rev().find(|&core| allowed.is_set(core));
            last.is_some_and(|core| {
                let mut one = CpuSet::new();
                one.set(core);
                sched_setaffinity(None, &one).is_ok()
            })
        });
        Self { before }
    }
}

impl Drop for Pinned {
    fn drop(&mut self) {
        if let Some(before) = &self.before {
            // Was allowed before.
            let _ = sched_setaffinity(None, before);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pinned_thread_has_one_core_and_then_its_former_ones() {
        let before = sched_getaffinity(None).unwrap();
        let pinned = Pinned::to_one_core();
        assert_eq!(sched_getaffinity(None).unwrap().count(), 1);
        drop(pinned);
        assert_eq!(sched_getaffinity(None).unwrap(), before);
    }
}
