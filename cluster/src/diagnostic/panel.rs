//! From what is known of a frame to colours and legends.

use super::Diagnostic;
use super::facts::FrameFacts;
use super::sheet::{Colour, Colours, Legend, Panel};
use crate::picture::Picture;

/// The frame itself.
pub(super) fn of_frame(picture: &Picture) -> Panel {
    let grey = picture.pixels().iter().map(|grey| [*grey; 3]).collect();
    Panel {
        title: "frame".to_owned(),
        picture: Colours::of(picture.size().width as usize, grey),
        legend: Legend::Plain,
    }
}

/// A picture of this kind.
pub(super) fn of(kind: Diagnostic, picture: &Picture, facts: &FrameFacts) -> Panel {
    let (colours, legend) = match kind {
        Diagnostic::TileOwner => tile_owners(facts),
        Diagnostic::PageOwner => page_owners(picture, facts),
        Diagnostic::Misses => {
            heat(facts, |index| u64::from(facts.measured[index].misses), |count| format!("{count} misses"))
        }
        Diagnostic::Cost => {
            heat(facts, |index| facts.measured[index].cost_ns / 1000, |us| format!("{us} us"))
        }
    };
    Panel { title: kind.name().to_owned(), picture: Colours::of(facts.width, colours), legend }
}

/// A grey for each node, over the tiles that it drew.
fn tile_owners(facts: &FrameFacts) -> (Vec<Colour>, Legend) {
    let nodes = facts.drawn_by.iter().flatten().max().map_or(1, |last| usize::from(*last) + 1);
    let grey = |node: usize| [byte((node + 1) as f64 / nodes as f64); 3];
    let of_tile = |index: usize| facts.drawn_by[index].map_or([0; 3], |node| grey(node.into()));
    let names = (0..nodes).map(|node| (grey(node), format!("node {node}"))).collect();
    (by_tile(facts, of_tile), Legend::Names(names))
}

/// A hue for each owner, as bright as the frame is there; where nothing is hit the frame's own grey.
fn page_owners(picture: &Picture, facts: &FrameFacts) -> (Vec<Colour>, Legend) {
    let owners = facts.owners.iter().copied().max().unwrap_or(0);
    let first = facts.owners.iter().copied().filter(|owner| *owner > 0).min().unwrap_or(1);
    let full = |owner: u8| {
        let turn = f64::from(owner - first) / f64::from(owners - first + 1);
        hue(turn)
    };
    let colour = |(owner, grey): (&u8, &u8)| match owner {
        0 => [*grey; 3],
        // What lies in shadow keeps enough of its hue to be told.
        owner => full(*owner).map(|part| byte(part * (0.25 + 0.75 * f64::from(*grey) / 255.0))),
    };
    let colours = facts.owners.iter().zip(picture.pixels()).map(colour).collect();
    let name = |owner: u8| (full(owner).map(byte), format!("owner {}", owner - 1));
    (colours, Legend::Names((first..=owners).map(name).collect()))
}

/// From black for none over red and yellow to white for the most of the frame.
fn heat(
    facts: &FrameFacts,
    value: impl Fn(usize) -> u64,
    name: impl Fn(u64) -> String,
) -> (Vec<Colour>, Legend) {
    let most = (0..facts.measured.len()).map(&value).max().unwrap_or(0);
    let colours = by_tile(facts, |index| glow(value(index) as f64 / most.max(1) as f64));
    let scale = (0..=255).map(|step| glow(f64::from(step) / 255.0)).collect();
    (colours, Legend::Scale(name(0), scale, name(most)))
}

/// The colour of each pixel by the number of its tile.
fn by_tile(facts: &FrameFacts, colour: impl Fn(usize) -> Colour) -> Vec<Colour> {
    let mut pixels = vec![[0; 3]; facts.owners.len()];
    for (index, tile) in facts.tiles.ids().filter_map(|id| facts.tiles.get(id)).enumerate() {
        for y in tile.y..tile.y + tile.height {
            let start = y as usize * facts.width + tile.x as usize;
            pixels[start..start + tile.width as usize].fill(colour(index));
        }
    }
    pixels
}

/// The colour of something that hot, from 0 to 1.
fn glow(heat: f64) -> Colour {
    [3.0 * heat, 3.0 * heat - 1.0, 3.0 * heat - 2.0].map(byte)
}

/// A full colour by its place on the circle, in turns: red, green and blue are a third apart.
fn hue(turn: f64) -> [f64; 3] {
    [0.0, 1.0, 2.0].map(|third| {
        let away = (turn - third / 3.0).rem_euclid(1.0);
        (2.0 - 6.0 * away.min(1.0 - away)).clamp(0.0, 1.0)
    })
}

fn byte(part: f64) -> u8 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    let byte = (part.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    byte
}

#[cfg(test)]
mod tests {
    use rt_core::TILE_SIZE;

    use super::super::facts::TileFacts;
    use super::super::facts::tests::unknown;
    use super::*;
    use crate::size::PictureSize;

    #[test]
    fn colours_go_where_they_belong() {
        assert_eq!(
            [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0].map(glow),
            [[0; 3], [255, 0, 0], [255, 255, 0], [255; 3]]
        );
        assert_eq!(
            [0.0, 1.0 / 3.0, 0.5].map(|turn| hue(turn).map(byte)),
            [[255, 0, 0], [0, 255, 0], [0, 255, 255]]
        );
    }

    #[test]
    fn every_kind_shows_what_is_known_of_each_tile() {
        let (width, height) = (2 * TILE_SIZE, TILE_SIZE);
        let mut facts = unknown(width, height);
        let picture = Picture::new(PictureSize { width, height });
        facts.drawn_by = vec![Some(1), Some(0)];
        facts.measured[1] = TileFacts { cost_ns: 5_000, misses: 3 };
        facts.owners[0] = 3;
        facts.owners[1] = 5;
        let shown = |kind| of(kind, &picture, &facts);
        let (first, second) = (0, TILE_SIZE as usize);
        let pixels = |panel: &Panel| panel.picture.pixels().to_vec();
        let owners = pixels(&shown(Diagnostic::TileOwner));
        assert_eq!((owners[first], owners[second]), ([255; 3], [128; 3]));
        for kind in [Diagnostic::Misses, Diagnostic::Cost] {
            let heat = shown(kind);
            assert_eq!((pixels(&heat)[first], pixels(&heat)[second]), ([0; 3], [255; 3]));
            let Legend::Scale(_, _, most) = heat.legend else { panic!("{kind:?} has a scale") };
            assert_eq!(most, if kind == Diagnostic::Misses { "3 misses" } else { "5 us" });
        }
        let pages = shown(Diagnostic::PageOwner);
        assert!(pixels(&pages)[0] != pixels(&pages)[1] && pixels(&pages)[2] == [0; 3]);
        let Legend::Names(names) = pages.legend else { panic!("owners have names") };
        assert_eq!(
            names.iter().map(|(_, name)| name.as_str()).collect::<Vec<_>>(),
            ["owner 2", "owner 3", "owner 4"]
        );
    }
}
