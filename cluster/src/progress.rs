//! Bars for people who look on; nothing where nobody does.

use std::io::IsTerminal;
use std::sync::Mutex;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use scene::{Progress, Stage};

/// A bar for building a scene, one stage after the other.
#[derive(Debug)]
pub(crate) struct StageBar {
    bar: ProgressBar,
    stage: Mutex<Option<Stage>>,
}

/// A bar for frames.
#[derive(Debug)]
pub(crate) struct FrameBar {
    bar: ProgressBar,
}

impl StageBar {
    pub(crate) fn new(quiet: bool) -> Self {
        Self {
            bar: bar(quiet, "{msg:8} {wide_bar} {percent:3} % of {human_len} primitives"),
            stage: Mutex::new(None),
        }
    }

    pub(crate) fn show(&self, progress: Progress) {
        let mut stage = self.stage.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if stage.replace(progress.stage) != Some(progress.stage) {
            self.bar.set_message(match progress.stage {
                Stage::Sort => "sorting",
                Stage::Grow => "growing",
                Stage::Write => "writing",
            });
            self.bar.set_length(progress.total);
        }
        self.bar.set_position(progress.done);
    }
}

impl Drop for StageBar {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

impl FrameBar {
    pub(crate) fn new(quiet: bool, frames: u32) -> Self {
        let bar = bar(quiet, "frame {pos} of {len} {wide_bar} {per_sec}");
        bar.set_length(frames.into());
        Self { bar }
    }

    /// So many moments of the session are over.
    pub(crate) fn set(&self, moments: u32) {
        self.bar.set_position(moments.into());
    }
}

impl Drop for FrameBar {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

fn bar(quiet: bool, template: &str) -> ProgressBar {
    let looked_at = !quiet && std::io::stderr().is_terminal();
    let target = if looked_at { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
    let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    let bar = ProgressBar::with_draw_target(None, target);
    bar.set_style(style);
    bar
}
