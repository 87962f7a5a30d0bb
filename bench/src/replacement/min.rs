//! `min`: the fewest misses that any policy can have, for who knows the future.

use std::collections::BinaryHeap;

/// Misses of a cache of `slots` pages that always evicts the page whose next touch is furthest ahead. Exact.
///
/// # Source
/// Belady, "A study of replacement algorithms for a virtual-storage computer", IBM Systems Journal 5(2), 1966.
pub(crate) fn misses(touches: &[u32], page_count: u32, slots: usize) -> u64 {
    let next_touches = next_touches(touches, page_count);
    // The next touch of each page that is there; 0 for a page that is not.
    let mut resident = vec![0; page_count as usize];
    let mut furthest = BinaryHeap::new();
    let (mut count, mut misses) = (0, 0);
    for (page, next_touch) in touches.iter().zip(next_touches) {
        if resident[*page as usize] == 0 {
            misses += 1;
            if count == slots {
                evict(&mut furthest, &mut resident);
            } else {
                count += 1;
            }
        }
        resident[*page as usize] = next_touch;
        furthest.push((next_touch, *page));
        // What was pushed before and is out of date lies below all that is not, and only takes room.
        if furthest.len() > 4 * slots + 1024 {
            furthest.retain(|(next_touch, page)| resident[*page as usize] == *next_touch);
        }
    }
    misses
}

/// For each touch, one more than the number of the next of the same page, or the highest number there is.
fn next_touches(touches: &[u32], page_count: u32) -> Vec<u32> {
    let mut next = vec![u32::MAX; page_count as usize];
    let mut next_touches = vec![0; touches.len()];
    for (index, (page, next_touch)) in touches.iter().zip(&mut next_touches).enumerate().rev() {
        let number = u32::try_from(index + 1).expect("a trace of less than 4 thousand million touches");
        *next_touch = core::mem::replace(&mut next[*page as usize], number);
    }
    next_touches
}

fn evict(furthest: &mut BinaryHeap<(u32, u32)>, resident: &mut [u32]) {
    while let Some((next_touch, page)) = furthest.pop() {
        if resident[page as usize] == next_touch {
            resident[page as usize] = 0;
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_a_cycle_all_but_the_slots_are_missed_anew_each_time_round() {
        // Ten pages, four slots: after the first round nine touches cost six misses (one of the slots is for what comes).
        let touches: Vec<u32> = (0..10).cycle().take(100).collect();
        assert_eq!(misses(&touches, 10, 10), 10);
        assert_eq!(misses(&touches, 10, 1), 100);
        assert_eq!(misses(&touches, 10, 4), 10 + 60);
    }

    #[test]
    fn the_textbook_example() {
        // Silberschatz et al., "Operating System Concepts", section on optimal replacement: nine faults with three slots.
        let touches = [7, 0, 1, 2, 0, 3, 0, 4, 2, 3, 0, 3, 2, 1, 2, 0, 1, 7, 0, 1];
        assert_eq!(misses(&touches, 8, 3), 9);
    }

    /// Tries every choice of victims.
    fn by_trying_all(touches: &[u32], held: &mut Vec<u32>, slots: usize) -> u64 {
        let Some((page, rest)) = touches.split_first() else { return 0 };
        if held.contains(page) {
            return by_trying_all(rest, held, slots);
        }
        if held.len() < slots {
            held.push(*page);
            let misses = 1 + by_trying_all(rest, held, slots);
            held.retain(|other| other != page);
            return misses;
        }
        let choices = (0..slots).map(|victim| {
            let mut held = held.clone();
            held[victim] = *page;
            1 + by_trying_all(rest, &mut held, slots)
        });
        choices.min().unwrap_or(0)
    }

    #[test]
    fn no_choice_of_victims_is_better() {
        let mut seed = 1_u32;
        for _ in 0..200 {
            let mut page = || {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (seed >> 16) % 5
            };
            let touches: Vec<u32> = (0..11).map(|_| page()).collect();
            for slots in 1..4 {
                assert_eq!(
                    misses(&touches, 5, slots),
                    by_trying_all(&touches, &mut Vec::new(), slots),
                    "{touches:?}"
                );
            }
        }
    }
}
