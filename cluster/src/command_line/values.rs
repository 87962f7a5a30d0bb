//! What flags may say that is no type of its own elsewhere.

use core::time::Duration;

use anyhow::{Context, Result, bail};
use fault_linux::BackendKind;
use rt_core::Kernel;
use rt_core::image::{PAGE_BYTES_MAX, PAGE_BYTES_MIN};
use scene::volume::StoredType;

use crate::scene_source::PAGE_BYTES_DEFAULT;
use crate::size::Bytes;

/// A backend by name, or the best that there is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Backend(pub(super) Option<BackendKind>);

/// A kernel by name, or the fastest that the processor has.
#[derive(Clone, Copy, Debug)]
pub(super) struct ChosenKernel(pub(super) Option<Kernel>);

pub(super) fn stored_type(name: &str) -> Result<StoredType> {
    StoredType::named(name).context("expected u8, u16 or f32")
}

pub(super) fn page_bytes(text: &str) -> Result<u32> {
    let Bytes(bytes) = text.parse()?;
    match u32::try_from(bytes) {
        Ok(bytes) if bytes.is_power_of_two() && (PAGE_BYTES_MIN..=PAGE_BYTES_MAX).contains(&bytes) => {
            Ok(bytes)
        }
        _ => bail!("a page is a power of two from 4K to 2M, as in {}", Bytes(PAGE_BYTES_DEFAULT.into())),
    }
}

pub(super) fn backend(name: &str) -> Result<Backend> {
    Ok(Backend(if name == "auto" { None } else { Some(name.parse()?) }))
}

pub(super) fn kernel(name: &str) -> Result<ChosenKernel> {
    Ok(ChosenKernel(if name == "auto" { None } else { Some(name.parse()?) }))
}

pub(super) fn seconds(text: &str) -> Result<Duration> {
    let seconds: f64 = text
        .parse()
        .ok()
        .filter(|seconds| (0.001..=86_400.0).contains(seconds))
        .context("expected seconds from 0.001 to 86400")?;
    Ok(Duration::from_secs_f64(seconds))
}
