//! Building `left-out`, a renderer with chosen features, and the size of its code.

use std::collections::HashMap;
use std::ffi::OsString;
use std::io::ErrorKind;
use std::path::PathBuf;
use std::process::Command;
use std::{env, fs, process};

use anyhow::{Context, Result, ensure};

/// Programs that were built so far, and their sizes.
#[derive(Debug)]
pub(super) struct Programs {
    folder: PathBuf,
    code_bytes: HashMap<Vec<&'static str>, Option<u64>>,
    /// There is no cargo to build with.
    is_without_cargo: bool,
}

const MANIFEST: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/left-out/Cargo.toml");

/// Something that the crate has to have; nothing of it is linked.
const WITHOUT_DRAWING: &[&str] = &["triangles"];

impl Programs {
    pub(super) fn new() -> Result<Self> {
        let folder = env::temp_dir().join(format!("left-out-{}", process::id()));
        fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
        Ok(Self { folder, code_bytes: HashMap::new(), is_without_cargo: false })
    }

    /// Bytes of code that drawing takes with these features, or `None` without cargo.
    ///
    /// # Errors
    /// When the program does not build.
    pub(super) fn code_bytes(&mut self, features: &[&'static str]) -> Result<Option<u64>> {
        let (whole, rest) = (self.text_bytes(features)?, self.text_bytes(WITHOUT_DRAWING)?);
        Ok(whole.zip(rest).map(|(whole, rest)| whole.saturating_sub(rest)))
    }

    /// What to say below the table.
    pub(super) fn notes(&self) -> impl Iterator<Item = &'static str> {
        self.is_without_cargo
            .then_some("code is not measured: there is no cargo here to build programs with")
            .into_iter()
    }

    /// Bytes of the section of code of the program with these features.
    fn text_bytes(&mut self, features: &[&'static str]) -> Result<Option<u64>> {
        if let Some(&known) = self.code_bytes.get(features) {
            return Ok(known);
        }
        let built = self.build(features)?;
        self.is_without_cargo |= !built;
        let program = self.folder.join("release/left-out");
        let bytes =
            if built { Some(text_bytes(&fs::read(program)?).context("no ELF program")?) } else { None };
        self.code_bytes.insert(features.to_vec(), bytes);
        Ok(bytes)
    }

    /// Builds the program; `false` when there is no cargo.
    fn build(&self, features: &[&str]) -> Result<bool> {
        let cargo = env::var_os("CARGO").unwrap_or_else(|| OsString::from("cargo"));
        let mut command = Command::new(cargo);
        command.args([
            "build",
            "--release",
            "--locked",
            "--quiet",
            "--manifest-path",
            MANIFEST,
            "--target-dir",
        ]);
        command.arg(&self.folder).args(["--no-default-features", "--features", &features.join(",")]);
        // How the bench itself is built is not how this is.
        command.env_remove("RUSTFLAGS").env_remove("CARGO_ENCODED_RUSTFLAGS");
        let output = match command.output() {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(false),
            output => output.context("cannot run cargo")?,
        };
        ensure!(output.status.success(), "{command:?} failed:\n{}", String::from_utf8_lossy(&output.stderr));
        Ok(true)
    }
}

impl Drop for Programs {
    fn drop(&mut self) {
        // What is left is in the folder for temporary files.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// Length of the sections that hold code in a 64-bit little-endian ELF file.
fn text_bytes(elf: &[u8]) -> Option<u64> {
    let number = |at: usize, length: usize| {
        let bytes = elf.get(at..at.checked_add(length)?)?;
        Some(bytes.iter().rev().fold(0_u64, |number, &byte| number << 8 | u64::from(byte)))
    };
    let place = |at: usize, length: usize| usize::try_from(number(at, length)?).ok();
    if !elf.starts_with(b"\x7fELF\x02\x01") {
        return None;
    }
    let (first, length, count) = (place(0x28, 8)?, place(0x3a, 2)?, place(0x3c, 2)?);
    let mut code = 0;
    for section in 0..count {
        let at = first.checked_add(section.checked_mul(length)?)?;
        // SHF_EXECINSTR.
        if number(at + 8, 8)? & 4 != 0 {
            code += number(at + 32, 8)?;
        }
    }
    Some(code)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_program_has_code_and_a_text_has_none() {
        let own = fs::read(env::current_exe().unwrap()).unwrap();
        let code = text_bytes(&own).unwrap();
        assert!(code > 10_000 && code < own.len() as u64, "{code} of {}", own.len());
        assert_eq!(text_bytes(b"no program"), None);
        assert_eq!(text_bytes(b"\x7fELF\x02\x01"), None);
    }
}
