//! What has happened so far.

/// Counts over the life of a world.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Tally {
    /// Tiles that were displayed.
    pub shown: u64,
    /// Copies of tiles that came when one was there already.
    pub again: u64,
    /// Tiles taken from other nodes.
    pub stolen: u64,
    /// Tiles that were dealt anew after a death.
    pub dealt_anew: u64,
    /// Frames that became whole.
    pub frames: u64,
    /// Nodes that ended.
    pub crashes: u64,
    /// Nodes that came back.
    pub restarts: u64,
    /// Messages that were refused.
    pub refused: u64,
}
