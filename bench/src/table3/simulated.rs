//! Clusters in virtual time.

use anyhow::{Result, ensure};
use dsm_sim::balance::{Config, FrameReport, Gather, Memory, run as simulate};
use dsm_sim::cluster::Ended;
use rt_core::schedule::Balancer;

use super::THREADS;
use super::real::COLD;
use super::tiles::{Measured, Slower};

/// What a cluster does in a frame after the first ones, in the mean.
#[derive(Clone, Copy, Debug)]
pub(super) struct Simulated {
    pub(super) frame_ms: f64,
    /// Communication of all displays.
    pub(super) displays_ms: f64,
    /// Communication of all displays and the supervisor.
    pub(super) talk_ms: f64,
    /// Of the thread that has most.
    pub(super) most_ms: f64,
    pub(super) parcels: f64,
    pub(super) moved: f64,
}

/// A cluster that draws all frames.
pub(super) fn config(nodes: u16, tiles: &Measured, balancer: Balancer, gather: Gather) -> Config {
    Config {
        threads: THREADS,
        tiles: [tiles.columns; 2],
        frames: tiles.frame_count(),
        resend_us: 50_000,
        gather: Some(gather),
        ..Config::new(nodes, balancer)
    }
}

pub(super) fn run(config: &Config, workload: &Slower<'_>) -> Result<Simulated> {
    let report = simulate(config, workload, &mut Memory::new(config), 1);
    ensure!(report.ended == Ended::Done, "{} nodes, {}: {:?}", config.nodes, config.balancer, report.ended);
    let warm = report.frames.get(COLD..).filter(|warm| !warm.is_empty()).unwrap_or(&report.frames);
    let mean = |of: fn(&FrameReport) -> f64| warm.iter().map(of).sum::<f64>() / warm.len().max(1) as f64;
    let ms = |ns: f64| ns / 1e6;
    Ok(Simulated {
        frame_ms: ms(mean(|frame| frame.ns as f64)),
        displays_ms: ms(mean(|frame| (frame.talk.sum() - frame.talk.supervisor) as f64)),
        talk_ms: ms(mean(|frame| frame.talk.sum() as f64)),
        most_ms: ms(mean(|frame| frame.talk.most() as f64)),
        parcels: mean(|frame| frame.talk.parcels as f64),
        moved: mean(|frame| f64::from(frame.moved)),
    })
}
