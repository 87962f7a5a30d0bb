//! `soft`: a table from page to slot that every access looks into. No signals and no memory management unit, hence
//! also the object-based sharing that the paper compares with.
//!
//! A reader *pins* the slot while it looks at a record; a slot is written only when no pin is left.

use core::ops::Deref;
use core::slice;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use dsm_core::id::{PageId, SlotId};
use dsm_core::transport::Body;

use crate::area::Area;
use crate::sys::{Errno, now};

/// The table and the slots.
#[derive(Debug)]
pub(crate) struct Soft {
    /// For each page its slot plus one, or 0 while it is absent.
    table: Box<[AtomicU32]>,
    /// For each slot how many records in it are being looked at.
    pins: Box<[AtomicU32]>,
    /// For each slot whether it was looked at since `clock` last asked; empty when nobody asks.
    touched: Box<[AtomicBool]>,
    slots: Area,
}

/// Bytes of a page in a slot, which cannot be evicted while this lives. Keep it short.
#[derive(Debug)]
pub struct Record<'a> {
    bytes: &'a [u8],
    pin: Option<&'a AtomicU32>,
}

/// A record held for longer is held by a thread that waits for its own slot, and would wait for ever.
const HOLD_US_MAX: u64 = 5_000_000;

impl Soft {
    pub(crate) fn new(
        page_count: u32,
        slot_count: u32,
        page_bytes: usize,
        watches_touches: bool,
    ) -> Result<Self, Errno> {
        let zeros = |count: u32| (0..count).map(|_| AtomicU32::new(0)).collect();
        let watched = if watches_touches { slot_count } else { 0 };
        let slots = Area::reserve(slot_count, page_bytes, libc::PROT_READ | libc::PROT_WRITE)?;
        Ok(Self {
            table: zeros(page_count),
            pins: zeros(slot_count),
            touched: (0..watched).map(|_| AtomicBool::new(false)).collect(),
            slots,
        })
    }

    /// The bytes `start..start + length` of `page`, pinned, or `None` while it is absent.
    pub(crate) fn pin(&self, page: PageId, start: usize, length: usize) -> Option<Record<'_>> {
        let slot = self.table[page.index()].load(Ordering::Acquire).checked_sub(1)? as usize;
        let pin = &self.pins[slot];
        // SeqCst: pairs with `take_away`, which clears the table and then looks at the pins. Whoever comes second
        // sees what the first has done: either this look finds the page gone, or that look finds the pin.
        pin.fetch_add(1, Ordering::SeqCst);
        if self.table[page.index()].load(Ordering::SeqCst) as usize != slot + 1 {
            unpin(pin);
            return None;
        }
        if let Some(touched) = self.touched.get(slot) {
            touched.store(true, Ordering::Relaxed);
        }
        let bytes = self.slots.address(PageId(u32::try_from(slot).ok()?)).wrapping_add(start);
        debug_assert!(start + length <= self.slots.page_bytes());
        // SAFETY: the bytes are readable and do not change while the record lives.
        // - In bounds: inside one slot, by the caller's check, and slots stay mapped as long as `self`.
        // - Unwritten: a slot is written only between `take_away` and `fill`, and `take_away` waits for the pin.
        let bytes = unsafe { slice::from_raw_parts(bytes, length) };
        Some(Record { bytes, pin: Some(pin) })
    }

    pub(super) fn fill(&self, page: PageId, slot: SlotId, body: Body<'_>) -> Result<(), Errno> {
        let place = self.slots.address(PageId(slot.0));
        // SAFETY: both ranges are a page long and apart.
        // - The source: the transport vouches for it as long as `body` lives; its length was checked.
        // - The slot: the state machine gave it to this page alone, and `take_away` has seen its last pin go.
        unsafe { core::ptr::copy_nonoverlapping(body.as_ptr(), place, self.slots.page_bytes()) };
        // Release: pairs with the Acquire in `pin`; whoever finds the slot finds the bytes.
        self.table[page.index()].store(slot.0 + 1, Ordering::Release);
        Ok(())
    }

    pub(super) fn take_away(&self, victims: &[(PageId, SlotId)]) -> Result<(), Errno> {
        for (page, _) in victims {
            self.table[page.index()].store(0, Ordering::SeqCst);
        }
        let start = now();
        for (_, slot) in victims {
            // A record is looked at for well under a microsecond, unless its thread is not running.
            while self.pins[slot.index()].load(Ordering::SeqCst) != 0 {
                if now().since(start) > HOLD_US_MAX {
                    return Err(Errno(libc::EDEADLK));
                }
                std::thread::yield_now();
            }
        }
        Ok(())
    }

    /// The slots that were looked at since the last call, if this backend was told to watch.
    pub(crate) fn take_touched(&self) -> impl Iterator<Item = SlotId> {
        let touched = |(slot, touched): (u32, &AtomicBool)| {
            (touched.load(Ordering::Relaxed) && touched.swap(false, Ordering::Relaxed))
                .then_some(SlotId(slot))
        };
        (0..).zip(&self.touched).filter_map(touched)
    }
}

impl<'a> Record<'a> {
    /// Bytes that never leave.
    pub(crate) const fn of_home(bytes: &'a [u8]) -> Self {
        Self { bytes, pin: None }
    }
}

impl Deref for Record<'_> {
    type Target = [u8];

    #[inline]
    fn deref(&self) -> &[u8] {
        self.bytes
    }
}

impl Drop for Record<'_> {
    #[inline]
    fn drop(&mut self) {
        if let Some(pin) = self.pin {
            unpin(pin);
        }
    }
}

#[inline]
fn unpin(pin: &AtomicU32) {
    // Release: pairs with the look in `take_away`; we are done with the bytes.
    pin.fetch_sub(1, Ordering::Release);
}
