//! Faults that can be put into the protocol on purpose, to see which engine notices. Only with `--cfg mutants`.
//!
//! In a program that is built without it, [`is_on`] is the constant `false` and nothing of this is left.

/// A way in which the protocol could be wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
#[cfg_attr(not(mutants), expect(unreachable_pub, reason = "public only where the faults can be switched on"))]
pub enum Mutant {
    /// A message of another epoch is believed.
    SkipEpochCheck = 1,
    /// A message of an older incarnation is believed.
    SkipIncarnationCheck,
    /// A message of a node that is dead is believed.
    BelieveTheDead,
    /// A message of a node that holds no copy of the page is believed.
    SkipHolderCheck,
    /// The request's number is not looked at.
    SkipNumberCheck,
    /// A page that came wakes nobody.
    WakeNobody,
    /// A slot that came free wakes nobody.
    WakeNoSlotWaiter,
    /// A victim's slot is given on before its readers have lost it.
    ReuseSlotEarly,
    /// A second grant of a page fills its slot again.
    GrantFillsTwice,
    /// A page is taken for whole when its first fragment has come.
    ForgetFragments,
    /// A page that is being filled may be chosen as a victim.
    EvictInUse,
    /// A request stays with its first copy, whatever happens there.
    NeverFailOver,
    /// The death of a peer is noted and its requests are left alone.
    ForgetRequestsOfTheDead,
    /// A request is sent once.
    NeverResend,
    /// A request has no deadline.
    NeverExpire,
    /// The time to the next resending never grows.
    NeverBackOff,
    /// Replicas are numbered from one too few.
    WrongReplicaIndex,
    /// A round trip is measured from the first sending, whichever was answered.
    MeasureFromFirst,
    /// A request made ahead is given up when a fault would be, and holds its slot as long.
    AheadTakesAllTime,
    /// A page that was asked for ahead and cannot be had has failed, although nobody has missed it.
    AheadFails,
    /// A fault on a page asked for ahead begins neither a time nor a round through the copies of its own.
    AdoptChangesNothing,
}

#[cfg(mutants)]
mod switch {
    use super::Mutant;
    use core::sync::atomic::{AtomicU8, Ordering};

    static ON: AtomicU8 = AtomicU8::new(0);

    impl Mutant {
        /// All of them.
        pub const ALL: [Self; 21] = [
            Self::SkipEpochCheck,
            Self::SkipIncarnationCheck,
            Self::BelieveTheDead,
            Self::SkipHolderCheck,
            Self::SkipNumberCheck,
            Self::WakeNobody,
            Self::WakeNoSlotWaiter,
            Self::ReuseSlotEarly,
            Self::GrantFillsTwice,
            Self::ForgetFragments,
            Self::EvictInUse,
            Self::NeverFailOver,
            Self::ForgetRequestsOfTheDead,
            Self::NeverResend,
            Self::NeverExpire,
            Self::NeverBackOff,
            Self::WrongReplicaIndex,
            Self::MeasureFromFirst,
            Self::AheadTakesAllTime,
            Self::AheadFails,
            Self::AdoptChangesNothing,
        ];
    }

    /// Makes the whole process wrong in this way, or right again.
    pub fn switch_to(mutant: Option<Mutant>) {
        ON.store(mutant.map_or(0, |mutant| mutant as u8), Ordering::SeqCst);
    }

    /// Whether the protocol is wrong in this way.
    pub(crate) fn is_on(mutant: Mutant) -> bool {
        ON.load(Ordering::Relaxed) == mutant as u8
    }
}

#[cfg(mutants)]
pub(crate) use switch::is_on;
#[cfg(mutants)]
pub use switch::switch_to;

/// Whether the protocol is wrong in this way: never.
#[cfg(not(mutants))]
pub(crate) const fn is_on(_: Mutant) -> bool {
    false
}
