//! Where the scene comes from: a mesh, a scene image, or a built-in scene.

use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom};
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use rt_core::Header;
use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, memfd_create};
use scene::builtin::{BuiltIn, BuiltInError};
use scene::{BuildOptions, Model, SceneFile};

use crate::progress::StageBar;
use crate::size::Bytes;

/// What to render.
#[derive(Clone, Debug)]
pub enum Source {
    /// A built-in scene.
    BuiltIn(BuiltIn),
    /// A mesh, or a scene image made by `memsavvy prepare`.
    Path(PathBuf),
}

/// A scene image, open for the processes to read their stripes from.
#[derive(Debug)]
pub(crate) struct Image {
    pub(crate) name: String,
    pub(crate) header: Header,
    file: OwnedFd,
    /// It lies in a memory file that nobody can change any more.
    is_frozen: bool,
}

/// Page size of images that are made on the fly, when nobody says.
pub(crate) const PAGE_BYTES_DEFAULT: u32 = 16 << 10;

impl Source {
    /// What was typed: the name of a built-in scene, unless there is a file of that name, or a path.
    ///
    /// # Errors
    /// The name is one of a built-in scene, and the number after it makes no sense.
    pub fn named(name: &Path) -> Result<Self> {
        match name.to_str().map_or(Err(BuiltInError::Unknown), str::parse) {
            Ok(built_in) if !name.exists() => Ok(Self::BuiltIn(built_in)),
            Err(error) if error != BuiltInError::Unknown && !name.exists() => Err(error.into()),
            _ => Ok(Self::Path(name.to_owned())),
        }
    }

    /// Makes or reads the model, and tells what to call it. A scene image is none.
    pub(crate) fn model(&self) -> Result<(String, Model)> {
        match self {
            Self::BuiltIn(built_in) => Ok((built_in.to_string(), built_in.model())),
            Self::Path(path) => {
                let name = path.display().to_string();
                let mesh = scene::read_mesh(path).with_context(|| format!("cannot read {name}"))?;
                Ok((name, mesh.into()))
            }
        }
    }

    /// Whether it is a scene image already.
    pub(crate) fn is_image(&self) -> Result<bool> {
        match self {
            Self::BuiltIn(_) => Ok(false),
            Self::Path(path) => {
                SceneFile::is_one(path).with_context(|| format!("cannot read {}", path.display()))
            }
        }
    }

    /// Builds or opens the image. A mesh is laid out for pages of `page_bytes`; an image must have been, or for smaller.
    pub(crate) fn open(&self, page_bytes: Option<u32>, quiet: bool) -> Result<Image> {
        match self {
            Self::Path(path) if self.is_image()? => open_image(path.display().to_string(), path, page_bytes),
            _ => {
                let (name, model) = self.model()?;
                build(name, model, page_bytes, quiet)
            }
        }
    }
}

impl Image {
    /// Copies the image into a memory file that nobody can change, unless it lies in one.
    ///
    /// For processes that map the whole of it: a file on disk could change under them.
    pub(crate) fn freeze(self) -> Result<Self> {
        if self.is_frozen {
            return Ok(self);
        }
        let mut from = File::from(self.file);
        from.seek(SeekFrom::Start(0))?;
        let mut to = memory_file()?;
        std::io::copy(&mut from, &mut to).context("cannot hold the image in memory")?;
        Ok(Self { file: frozen(to)?, is_frozen: true, ..self })
    }
}

impl From<Image> for OwnedFd {
    fn from(image: Image) -> Self {
        image.file
    }
}

fn open_image(name: String, path: &Path, page_bytes: Option<u32>) -> Result<Image> {
    let opened = SceneFile::open(path).with_context(|| format!("cannot use {name}"))?;
    let header = *opened.header();
    if let Some(wanted) = page_bytes.filter(|wanted| *wanted < header.page_bytes) {
        bail!(
            "{name} was prepared for pages of {}, and --page {} is smaller: its records would cross pages; prepare it \
             anew with --page {wanted}",
            Bytes(header.page_bytes.into()),
            Bytes(wanted.into()),
        );
    }
    let file = opened.file().try_clone()?.into();
    Ok(Image { name, header, file, is_frozen: false })
}

fn build(name: String, model: Model, page_bytes: Option<u32>, quiet: bool) -> Result<Image> {
    let bar = StageBar::new(quiet);
    let progress = |progress| bar.show(progress);
    let built = scene::build(model, &BuildOptions::default(), &progress)
        .with_context(|| format!("cannot use {name}"))?;
    let mut file = BufWriter::with_capacity(1 << 20, memory_file()?);
    let header = built.write(page_bytes.unwrap_or(PAGE_BYTES_DEFAULT), &mut file, &progress)?;
    let file = file.into_inner().map_err(std::io::IntoInnerError::into_error)?;
    Ok(Image { name, header, file: frozen(file)?, is_frozen: true })
}

fn memory_file() -> Result<File> {
    let file = memfd_create("memsavvy-image", MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING);
    Ok(File::from(file.context("cannot get a memory file for the scene image")?))
}

fn frozen(file: File) -> Result<OwnedFd> {
    let seals = SealFlags::SHRINK | SealFlags::GROW | SealFlags::WRITE | SealFlags::SEAL;
    fcntl_add_seals(&file, seals).context("cannot seal the scene image")?;
    Ok(file.into())
}
