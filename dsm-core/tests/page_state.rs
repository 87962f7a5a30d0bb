//! The transition table as a snapshot: a change of the protocol is a visible change of this file's neighbour.

use core::fmt::Write;
use dsm_core::page_state::{PageEvent, PageState};

fn print_table() -> String {
    let mut table = String::new();
    for state in PageState::ALL {
        for event in PageEvent::ALL {
            let (next, effect) = state.on(event);
            writeln!(
                table,
                "{:<10} {:<9} -> {:<10} {:?}",
                format!("{state:?}"),
                format!("{event:?}"),
                format!("{next:?}"),
                effect
            )
            .unwrap();
        }
        table.push('\n');
    }
    table
}

#[test]
fn the_table_is_the_one_that_was_reviewed() {
    let table = print_table();
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/page_state.txt");
    if std::env::var_os("UPDATE_SNAPSHOTS").is_some() {
        std::fs::write(path, &table).unwrap();
    }
    let reviewed = std::fs::read_to_string(path).unwrap();
    assert_eq!(table, reviewed, "the protocol changed; review it and run with UPDATE_SNAPSHOTS=1");
}

#[test]
fn only_a_page_with_a_slot_gives_one_up_and_only_one_without_takes_one() {
    for state in PageState::ALL {
        for event in PageEvent::ALL {
            let (next, effect) = state.on(event);
            let name = format!("{effect:?}");
            let takes = name == "SendRequest";
            let gives = ["Release", "Fail", "Forget"].contains(&name.as_str());
            assert_eq!(takes, !state.holds_slot() && next.holds_slot(), "{state:?} {event:?}");
            assert_eq!(gives, state.holds_slot() && !next.holds_slot(), "{state:?} {event:?}");
        }
    }
}

#[test]
fn the_drawing_has_every_state_and_every_event_that_changes_one() {
    let architecture = include_str!("../../ARCHITECTURE.md");
    let section = architecture.split("## The life of a page").nth(1).expect("the section");
    let drawing = section.split("```").nth(1).expect("the drawing");
    for state in PageState::ALL {
        let moves: Vec<PageEvent> =
            PageEvent::ALL.into_iter().filter(|event| state.on(*event).0 != state).collect();
        // A node's own pages never move, so they are not drawn.
        assert!(drawing.contains(&format!("{state:?}")) || state == PageState::Home, "{state:?}");
        for event in moves {
            assert!(drawing.contains(&format!("{event:?}")), "{state:?}: {event:?}");
        }
    }
}
