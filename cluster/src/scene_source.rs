//! Where the scene comes from: a mesh, a volume, a scene image, or a built-in scene.

use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::os::fd::OwnedFd;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use rt_core::Header;
use rt_core::volume::TABLE_BYTES;
use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, memfd_create};
use scene::builtin::{BuiltIn, BuiltInError};
use scene::volume::{Histogram, Note, StoredType, VolumeName};
use scene::{BuildOptions, Mesh, Model, Progress, SceneFile};

use crate::progress::StageBar;
use crate::size::Bytes;

/// What to render.
#[derive(Clone, Debug)]
pub enum Source {
    /// A built-in scene.
    BuiltIn(BuiltIn),
    /// A mesh, or a scene image made by `memsavvy prepare`.
    Path(PathBuf),
    /// A volume.
    Volume(VolumeInput),
}

/// A volume, how it is stored, and what stands in it.
#[derive(Clone, Debug)]
pub struct VolumeInput {
    /// A file or a formula.
    pub name: VolumeName,
    /// What a sample is stored as; `None`: the smallest type that loses nothing.
    pub stored: Option<StoredType>,
    /// A mesh in the same world units.
    pub with: Option<PathBuf>,
}

/// What became of a source in a file.
#[derive(Debug)]
pub(crate) struct Written {
    pub(crate) name: String,
    pub(crate) header: Header,
    /// What was not taken as it stands in a volume's file.
    pub(crate) notes: Vec<Note>,
}

/// A scene image, open for the processes to read their stripes from.
#[derive(Debug)]
pub(crate) struct Image {
    pub(crate) name: String,
    pub(crate) header: Header,
    /// What was not taken as it stands in a volume's file.
    pub(crate) notes: Vec<Note>,
    file: OwnedFd,
    /// It lies in a memory file that nobody can change any more.
    is_frozen: bool,
}

/// Page size of images that are made on the fly, when nobody says.
pub(crate) const PAGE_BYTES_DEFAULT: u32 = 16 << 10;

impl Source {
    /// What was typed: the name of a built-in scene or volume, unless there is a file of that name, or a path.
    ///
    /// # Errors
    /// The name is one of a built-in scene or a volume, and what follows makes no sense; or a file cannot be read.
    pub fn named(name: &Path) -> Result<Self> {
        match name.to_str().map_or(Err(BuiltInError::Unknown), str::parse) {
            Ok(built_in) if !name.exists() => return Ok(Self::BuiltIn(built_in)),
            Err(error) if error != BuiltInError::Unknown && !name.exists() => return Err(error.into()),
            _ => {}
        }
        let volume = VolumeName::recognise(name).with_context(|| format!("cannot use {}", name.display()))?;
        Ok(match volume {
            Some(name) => Self::Volume(VolumeInput { name, stored: None, with: None }),
            None => Self::Path(name.to_owned()),
        })
    }

    /// The isovalue whose surface is the one to see, where the source knows it.
    pub(crate) fn isovalue(&self) -> Option<f64> {
        match self {
            Self::Volume(VolumeInput { name: VolumeName::Analytic { formula, .. }, .. }) => {
                Some(formula.isovalue())
            }
            _ => None,
        }
    }

    /// Makes the scene image, with pages of `page_bytes`.
    pub(crate) fn write(&self, page_bytes: u32, out: &mut BufWriter<File>, quiet: bool) -> Result<Written> {
        let bar = StageBar::new(quiet);
        let progress = |progress| bar.show(progress);
        match self {
            Self::Volume(volume) => volume.write(page_bytes, out, &progress),
            Self::BuiltIn(built_in) => {
                write_model(built_in.to_string(), built_in.model(), page_bytes, out, &progress)
            }
            Self::Path(path) => {
                let (name, mesh) = read_mesh(path)?;
                write_model(name, mesh.into(), page_bytes, out, &progress)
            }
        }
    }

    /// Whether it is a scene image already.
    pub(crate) fn is_image(&self) -> Result<bool> {
        match self {
            Self::BuiltIn(_) | Self::Volume(_) => Ok(false),
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
                let mut file = BufWriter::with_capacity(1 << 20, memory_file()?);
                let written = self.write(page_bytes.unwrap_or(PAGE_BYTES_DEFAULT), &mut file, quiet)?;
                let file = file.into_inner().map_err(std::io::IntoInnerError::into_error)?;
                let Written { name, header, notes } = written;
                Ok(Image { name, header, notes, file: frozen(file)?, is_frozen: true })
            }
        }
    }
}

impl Image {
    /// An isovalue that the spread of the volume's samples suggests; `None` when they are all the same, or when there
    /// is no volume.
    pub(crate) fn auto_isovalue(&self) -> Result<Option<f64>> {
        let Some(volume) = &self.header.volume else { return Ok(None) };
        let mut bytes = vec![0; TABLE_BYTES];
        File::from(self.file.try_clone()?).read_exact_at(&mut bytes, self.header.segments.table.offset)?;
        Ok(Histogram::of_image(volume, &bytes).and_then(|histogram| histogram.auto_isovalue()))
    }

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
    Ok(Image { name, header, notes: Vec::new(), file, is_frozen: false })
}

impl VolumeInput {
    fn write(
        &self,
        page_bytes: u32,
        out: &mut BufWriter<File>,
        progress: &(dyn Fn(Progress) + Sync),
    ) -> Result<Written> {
        let Self { name, stored, with } = self;
        let mut source = name.clone().open().with_context(|| format!("cannot use {name}"))?;
        let mut title = name.to_string();
        let mut built = None;
        if let Some(path) = with {
            let (of_mesh, mesh) = read_mesh(path)?;
            let scene = scene::build(mesh, &BuildOptions::default(), progress);
            built = Some(scene.with_context(|| format!("cannot use {of_mesh}"))?);
            title = format!("{title} and {of_mesh}");
        }
        out.flush()?;
        let notes = source.shape().notes.clone();
        let header = scene::write_volume(
            source.as_mut(),
            built.as_ref(),
            *stored,
            page_bytes,
            out.get_mut(),
            progress,
        )
        .with_context(|| format!("cannot use {name}"))?;
        Ok(Written { name: title, header, notes })
    }
}

fn read_mesh(path: &Path) -> Result<(String, Mesh)> {
    let name = path.display().to_string();
    let mesh = scene::read_mesh(path).with_context(|| format!("cannot read {name}"))?;
    Ok((name, mesh))
}

fn write_model(
    name: String,
    model: Model,
    page_bytes: u32,
    out: &mut BufWriter<File>,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<Written> {
    let built = scene::build(model, &BuildOptions::default(), progress)
        .with_context(|| format!("cannot use {name}"))?;
    let header = built.write(page_bytes, out, progress)?;
    Ok(Written { name, header, notes: Vec::new() })
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
