//! A scene of two owners, of which one is here and one is a page file: every byte says which page it is of.
#![allow(dead_code, reason = "each test file uses its own part")]

use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::FileExt;
use std::os::unix::process::ExitStatusExt;
use std::process::{Command, Output};
use std::sync::Arc;

use dsm_core::home::Home;
use dsm_core::id::NodeId;
use dsm_core::node::Config;
use dsm_core::placement::Stripes;
use dsm_core::replacement::{PolicyKind, ReferenceSource};
use fault_linux::{BackendKind, Region, Setup};
use transport_shm::{DirectPort, PageFile};

pub(crate) const ME: NodeId = NodeId(0);
pub(crate) const OTHER: NodeId = NodeId(1);

/// A scene of `pages` pages, half of them at each owner.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scene {
    pub(crate) pages: u32,
    pub(crate) page_bytes: u32,
    pub(crate) slots: u32,
    pub(crate) policy: PolicyKind,
    pub(crate) deadline_us: u64,
    /// Pages that a missed one may bring along; then hints tell which are used.
    pub(crate) neighbours_max: u32,
}

impl Scene {
    pub(crate) const SMALL: Self = Self {
        pages: 64,
        page_bytes: 16384,
        slots: 5,
        policy: PolicyKind::Random,
        deadline_us: 2_000_000,
        neighbours_max: 0,
    };

    pub(crate) fn config(&self) -> Config {
        let placement = Stripes::new(self.pages, 2, ME, 2).unwrap();
        let Self { deadline_us, neighbours_max, .. } = *self;
        Config { deadline_us, neighbours_max, ..Config::new(ME, placement, self.page_bytes) }
    }

    pub(crate) fn region(&self, backend: Option<BackendKind>) -> Arc<Region> {
        let home = Some(self.page_file(ME).as_fd().try_clone_to_owned().unwrap());
        let Self { policy, slots: slot_count, .. } = *self;
        let setup = Setup {
            node: self.config(),
            policy,
            reference: if self.neighbours_max > 0 {
                ReferenceSource::Hints
            } else {
                ReferenceSource::SoftFaults
            },
            hidden_per_cent: 40,
            prefetch: false,
            seed: 1,
            slot_count,
            home,
            backend,
        };
        // SAFETY: nobody writes the page files once they are filled.
        unsafe { Region::new(setup) }.unwrap()
    }

    /// The pages of one owner, each full of the words that [`word`] gives.
    pub(crate) fn page_file(&self, owner: NodeId) -> Arc<PageFile> {
        let placement = self.config().placement;
        let bytes = u64::from(placement.home_pages(owner)) * u64::from(self.page_bytes);
        let file = PageFile::create(bytes).unwrap();
        let mut offset = 0;
        for page in placement.stripes_of(owner).flatten() {
            let words: Vec<u8> =
                (0..self.page_bytes / 8).flat_map(|index| word(page, index).to_le_bytes()).collect();
            file.file().write_all_at(&words, offset).unwrap();
            offset += u64::from(self.page_bytes);
        }
        file.freeze().unwrap();
        Arc::new(file)
    }

    /// A way to the other owner, over its page file.
    pub(crate) fn port(&self, pages: &Arc<PageFile>) -> DirectPort {
        let config = self.config();
        let home = Home::new(OTHER, config.cluster, config.epoch, config.placement, self.page_bytes);
        let mut port = DirectPort::new(self.page_bytes);
        port.connect(OTHER, home, pages.clone());
        port
    }

    /// The image as one file, for the replicated baseline.
    pub(crate) fn image(&self) -> OwnedFd {
        let file = PageFile::create(u64::from(self.pages) * u64::from(self.page_bytes)).unwrap();
        for page in 0..self.pages {
            let words: Vec<u8> =
                (0..self.page_bytes / 8).flat_map(|index| word(page, index).to_le_bytes()).collect();
            file.file().write_all_at(&words, u64::from(page) * u64::from(self.page_bytes)).unwrap();
        }
        file.as_fd().try_clone_to_owned().unwrap()
    }

    pub(crate) fn words_per_page(&self) -> u32 {
        self.page_bytes / 8
    }
}

/// The word at `index` of `page`.
pub(crate) fn word(page: u32, index: u32) -> u64 {
    (u64::from(page) << 32 | u64::from(index)) ^ 0xA5A5_5A5A_0F0F_F0F0
}

/// Reads a word of a region by a plain load that the compiler must not move or merge.
pub(crate) fn read_word(bytes: &[u8], page_bytes: u32, page: u32, index: u32) -> u64 {
    let offset = page as usize * page_bytes as usize + index as usize * 8;
    let word = bytes[offset..].as_ptr();
    assert!(offset + 8 <= bytes.len());
    // SAFETY: in bounds, checked above; regions are page-aligned, so words are aligned.
    unsafe { word.cast::<u64>().read_volatile() }
}

/// Numbers that repeat for a seed.
pub(crate) struct Numbers(pub(crate) u64);

impl Numbers {
    pub(crate) fn below(&mut self, bound: u32) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        u32::try_from(((self.0 >> 32) * u64::from(bound)) >> 32).unwrap()
    }
}

const IN_CHILD: &str = "FAULT_LINUX_TEST_CHILD";

/// Runs the test of this name in a process of its own, where `is_child` is true.
pub(crate) fn run_in_child(test: &str) -> Output {
    let mut child = Command::new(std::env::current_exe().unwrap());
    child.args(["--exact", test, "--nocapture", "--test-threads=1"]).env(IN_CHILD, "1");
    child.output().unwrap()
}

pub(crate) fn is_child() -> bool {
    std::env::var_os(IN_CHILD).is_some()
}

/// Whether the child died of `signal` and said `words`.
pub(crate) fn assert_died(output: &Output, signal: i32, words: &str) {
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.signal(), Some(signal), "{:?}: {said}", output.status);
    assert!(said.contains(words), "{said}");
}
