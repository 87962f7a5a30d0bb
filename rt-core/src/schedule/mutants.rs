//! Faults that can be put into the balance on purpose, to see which engine notices. Only with `--cfg mutants`.
//!
//! In a program that is built without it, [`is_on`] is the constant `false` and nothing of this is left.

/// A way in which the balance could be wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
#[cfg_attr(not(mutants), expect(unreachable_pub, reason = "public only where the faults can be switched on"))]
pub enum Mutant {
    /// A tile that is there is displayed again.
    DisplayTwice = 1,
    /// A frame is taken for whole when one tile is missing.
    EndEarly,
    /// A tile of the last frame is displayed in this one.
    AcceptOldFrame,
    /// What a dead node owed is not dealt anew.
    ForgetTilesOfTheDead,
    /// What waits for a node in the central queue's next deal is never sent.
    ForgetWaiting,
    /// A thief says that it has taken a tile and does not keep it.
    ForgetGift,
    /// A donor keeps what it gives away.
    KeepGiven,
    /// What nodes said in an earlier view is believed.
    SkipViewCheck,
    /// A message of another run is believed.
    SkipEpochCheck,
    /// A node that finds nothing asks for ever.
    NeverRest,
    /// Deals and gifts are sent once.
    NeverResend,
    /// That a tile has come is not heard.
    IgnoreShown,
    /// A new view leaves a node what it had queued.
    KeepOldHand,
}

#[cfg(mutants)]
mod switch {
    use super::Mutant;
    use core::sync::atomic::{AtomicU8, Ordering};

    static ON: AtomicU8 = AtomicU8::new(0);

    impl Mutant {
        /// All of them.
        pub const ALL: [Self; 13] = [
            Self::DisplayTwice,
            Self::EndEarly,
            Self::AcceptOldFrame,
            Self::ForgetTilesOfTheDead,
            Self::ForgetWaiting,
            Self::ForgetGift,
            Self::KeepGiven,
            Self::SkipViewCheck,
            Self::SkipEpochCheck,
            Self::NeverRest,
            Self::NeverResend,
            Self::IgnoreShown,
            Self::KeepOldHand,
        ];
    }

    /// Makes the whole process wrong in this way, or right again.
    pub fn switch_to(mutant: Option<Mutant>) {
        ON.store(mutant.map_or(0, |mutant| mutant as u8), Ordering::SeqCst);
    }

    /// Whether the balance is wrong in this way.
    pub(crate) fn is_on(mutant: Mutant) -> bool {
        ON.load(Ordering::Relaxed) == mutant as u8
    }
}

#[cfg(mutants)]
pub(crate) use switch::is_on;
#[cfg(mutants)]
pub use switch::switch_to;

/// Whether the balance is wrong in this way: never.
#[cfg(not(mutants))]
pub(crate) const fn is_on(_: Mutant) -> bool {
    false
}
