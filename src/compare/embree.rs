//! Embree 3 in the same process, through `benches/embree.c`.

use std::ffi::{c_int, c_long, c_void};
use std::io::ErrorKind;
use std::mem::ManuallyDrop;
use std::path::Path;
use std::process::Command;
use std::ptr::NonNull;
use std::sync::Arc;

use anyhow::{Context, Result, anyhow, bail, ensure};
use libloading::Library;
use rayon::prelude::*;

use crate::child::Supervised;
use crate::port;
use crate::temporary;
use crate::tools::complaint;

/// The C source that is compiled and loaded.
const SOURCE: &str = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/benches/embree.c"));

/// The command that installs Embree.
const INSTALL: &str = "apt-get install libembree-dev";

/// Rays per task: a multiple of 4, and large enough that the distribution over threads costs almost nothing.
const RAYS_AT_A_TIME: usize = 1024;

/// A ray in single precision, as `dynrt_ray` in the C file.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    origin: [f32; 3],
    tmin: f32,
    direction: [f32; 3],
    tmax: f32,
    active: u32,
}

impl Ray {
    /// The ray in single precision, if that represents it exactly.
    pub fn exactly(ray: &port::Ray) -> Option<Ray> {
        Some(Ray {
            origin: exactly(ray.origin)?,
            tmin: exactly([ray.tmin])?[0],
            direction: exactly(ray.direction)?,
            tmax: exactly([ray.tmax])?[0],
            active: ray.active.into(),
        })
    }
}

/// The numbers in single precision, if that represents them exactly.
pub fn exactly<const N: usize>(numbers: [f64; N]) -> Option<[f32; N]> {
    let single = numbers.map(|x| x as f32);
    (single.map(f64::from) == numbers).then_some(single)
}

/// The result for a ray, as `dynrt_hit` in the C file.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    t: f32,
    u: f32,
    v: f32,
    triangle: u32,
}

impl Hit {
    pub const MISS: Hit = Hit {
        t: f32::INFINITY,
        u: 0.0,
        v: 0.0,
        triangle: port::NONE,
    };

    /// Whether both results name the same triangle, or both are misses.
    pub fn same_triangle(&self, other: &Hit) -> bool {
        self.triangle == other.triangle
    }
}

impl From<Hit> for port::Hit {
    fn from(hit: Hit) -> Self {
        match hit.triangle {
            port::NONE => port::Hit::MISS,
            triangle => port::Hit {
                t: hit.t.into(),
                u: hit.u.into(),
                v: hit.v.into(),
                instance: 0,
                triangle,
            },
        }
    }
}

/// The C file's functions.
#[derive(Clone, Copy)]
struct Functions {
    open: unsafe extern "C" fn() -> *mut c_void,
    close: unsafe extern "C" fn(*mut c_void),
    version: unsafe extern "C" fn(*mut c_void) -> c_long,
    error: unsafe extern "C" fn(*mut c_void) -> c_int,
    mesh: unsafe extern "C" fn(
        *mut c_void,
        *const f32,
        usize,
        *const u32,
        usize,
        c_int,
    ) -> *mut c_void,
    free: unsafe extern "C" fn(*mut c_void),
    move_to: unsafe extern "C" fn(*mut c_void, *const f32),
    commit: unsafe extern "C" fn(*mut c_void),
    cast: unsafe extern "C" fn(*mut c_void, *const Ray, *mut Hit, usize, c_int) -> c_int,
}

/// The loaded library, with one device that builds on one core.
pub struct Embree {
    functions: Functions,
    device: NonNull<c_void>,
    /// Never unloaded, because Embree's threads remain and execute its code.
    _library: ManuallyDrop<Library>,
}

// SAFETY: Embree's functions of a device may be called from any number of threads.
unsafe impl Send for Embree {}
// SAFETY: as above.
unsafe impl Sync for Embree {}

impl Embree {
    /// Compiles the C file and loads it together with Embree.
    ///
    /// # Errors
    /// One line if the compiler or Embree is missing, with the command that installs it.
    pub fn load() -> Result<Arc<Embree>> {
        let folder = temporary::Folder::new().context("no temporary folder can be made")?;
        let path = folder.path().join("embree.so");
        compile(folder.path(), &path)?;
        // SAFETY: loading runs only the initialisers of Embree and its thread library.
        let library = unsafe { Library::new(&path) }
            .map_err(|error| anyhow!("Embree 3 cannot be loaded: {error}; {INSTALL}"))?;
        macro_rules! function {
            ($name:literal) => {
                *unsafe { library.get($name) }
                    .map_err(|error| anyhow!("benches/embree.c: {error}"))?
            };
        }
        // SAFETY: each name has this signature in the C file, which was just compiled.
        let functions = Functions {
            open: function!(b"dynrt_open"),
            close: function!(b"dynrt_close"),
            version: function!(b"dynrt_version"),
            error: function!(b"dynrt_error"),
            mesh: function!(b"dynrt_mesh"),
            free: function!(b"dynrt_free"),
            move_to: function!(b"dynrt_move"),
            commit: function!(b"dynrt_commit"),
            cast: function!(b"dynrt_cast"),
        };
        let _library = ManuallyDrop::new(library);
        // SAFETY: the function has no preconditions.
        let device = NonNull::new(unsafe { (functions.open)() })
            .context("Embree cannot be started on this processor")?;
        Ok(Arc::new(Embree {
            functions,
            device,
            _library,
        }))
    }

    /// Embree's version, as major.minor.patch.
    pub fn version(&self) -> String {
        // SAFETY: the device is open.
        let number = unsafe { (self.functions.version)(self.device.as_ptr()) };
        format!("{}.{}.{}", number / 10000, number / 100 % 100, number % 100)
    }

    /// Checks that Embree has reported no error in this thread since the last call.
    fn check(&self) -> Result<()> {
        // SAFETY: the device is open.
        meaning(unsafe { (self.functions.error)(self.device.as_ptr()) })
    }
}

/// The meaning of an error number; 0 is no error.
fn meaning(error: c_int) -> Result<()> {
    let meaning = match error {
        0 => return Ok(()),
        2 => "invalid argument",
        3 => "invalid operation",
        4 => "out of memory",
        6 => "this processor is not supported",
        _ => "unknown",
    };
    bail!("Embree reports error {error}: {meaning}")
}

impl Drop for Embree {
    fn drop(&mut self) {
        // SAFETY: the device is open, and no mesh is left, because meshes keep a reference to it.
        unsafe { (self.functions.close)(self.device.as_ptr()) }
    }
}

/// Compiles the C file.
fn compile(folder: &Path, library: &Path) -> Result<()> {
    let source = folder.join("embree.c");
    std::fs::write(&source, SOURCE)
        .with_context(|| format!("{}: cannot be written", source.display()))?;
    let output = Command::new("cc")
        .args(["-std=c11", "-O3", "-fPIC", "-shared", "-o"])
        .arg(library)
        .arg(&source)
        .arg("-lembree3")
        .supervised_output()
        .map_err(|error| match error.kind() {
            ErrorKind::NotFound => anyhow!("cc is not installed: apt-get install gcc"),
            _ => anyhow!("cannot run cc: {error}"),
        })?;
    if output.status.success() {
        return Ok(());
    }
    let printed = String::from_utf8_lossy(&output.stderr);
    // The message mentions the header, or the library if the linker reports it.
    let missing = ["embree3/rtcore.h: No such file", "cannot find -lembree3"];
    if missing.iter().any(|text| printed.contains(text)) {
        bail!("Embree 3 is not installed: {INSTALL}");
    }
    bail!(
        "cc cannot compile benches/embree.c: {}; {INSTALL}",
        complaint(&printed).unwrap_or_else(|| output.status.to_string())
    )
}

/// A mesh in Embree, in robust mode.
pub struct Mesh {
    embree: Arc<Embree>,
    handle: NonNull<c_void>,
    vertex_count: usize,
}

// SAFETY: a mesh is changed only through `&mut self`; rays may be cast from any number of threads.
unsafe impl Send for Mesh {}
// SAFETY: as above.
unsafe impl Sync for Mesh {}

impl Mesh {
    /// Passes a mesh to Embree without building it. If it `moves`, every [`Mesh::commit`] after the first is a refit.
    ///
    /// # Errors
    /// One line, if Embree reports one.
    ///
    /// # Panics
    /// If a triangle names a missing vertex.
    pub fn new(
        embree: &Arc<Embree>,
        vertices: &[[f32; 3]],
        triangles: &[[u32; 3]],
        moves: bool,
    ) -> Result<Mesh> {
        let indices = triangles.as_flattened();
        assert!(indices.iter().all(|&i| (i as usize) < vertices.len()));
        // SAFETY: both arrays have the stated lengths; they are copied.
        let handle = unsafe {
            (embree.functions.mesh)(
                embree.device.as_ptr(),
                vertices.as_ptr().cast(),
                vertices.len(),
                indices.as_ptr(),
                triangles.len(),
                moves.into(),
            )
        };
        let mesh = NonNull::new(handle).map(|handle| Mesh {
            embree: embree.clone(),
            handle,
            vertex_count: vertices.len(),
        });
        embree.check()?;
        mesh.context("Embree cannot hold the mesh: out of memory")
    }

    /// Builds the index. For a mesh that moves, refits it from the second call on.
    ///
    /// # Errors
    /// One line, if Embree reports one.
    pub fn commit(&mut self) -> Result<()> {
        // SAFETY: the mesh is complete, and no rays are being cast.
        unsafe { (self.embree.functions.commit)(self.handle()) };
        self.embree.check()
    }

    /// Sets the vertices of a mesh that moves, before a commit.
    ///
    /// # Panics
    /// If the number of vertices differs.
    pub fn move_to(&mut self, vertices: &[[f32; 3]]) {
        assert_eq!(vertices.len(), self.vertex_count);
        // SAFETY: the mesh's buffer has this length.
        unsafe { (self.embree.functions.move_to)(self.handle(), vertices.as_ptr().cast()) }
    }

    /// Casts rays at the committed mesh on all threads of the current pool, one by one or four at a time.
    ///
    /// # Errors
    /// One line, if Embree reports one.
    ///
    /// # Panics
    /// If the numbers of hits and rays differ.
    pub fn cast(&self, rays: &[Ray], hits: &mut [Hit], by_four: bool) -> Result<()> {
        assert_eq!(rays.len(), hits.len());
        let Functions { cast, .. } = self.embree.functions;
        rays.par_chunks(RAYS_AT_A_TIME)
            .zip(hits.par_chunks_mut(RAYS_AT_A_TIME))
            .try_for_each(|(rays, hits)| {
                let (count, by_four) = (rays.len(), by_four.into());
                // SAFETY: the arrays have equal lengths; the mesh does not change while `self` is borrowed.
                meaning(unsafe {
                    cast(
                        self.handle(),
                        rays.as_ptr(),
                        hits.as_mut_ptr(),
                        count,
                        by_four,
                    )
                })
            })
    }

    fn handle(&self) -> *mut c_void {
        self.handle.as_ptr()
    }
}

impl Drop for Mesh {
    fn drop(&mut self) {
        // SAFETY: no other reference to the mesh exists.
        unsafe { (self.embree.functions.free)(self.handle()) }
    }
}

/// Converts the vertices to single precision; fails if a number is not representable.
pub(super) fn vertices_exactly(vertices: &[[f64; 3]]) -> Result<Vec<[f32; 3]>> {
    vertices
        .iter()
        .map(|&vertex| exactly(vertex))
        .collect::<Option<_>>()
        .context(BEYOND_SINGLE)
}

/// Converts the rays to single precision.
pub(super) fn rays_exactly(rays: &[port::Ray]) -> Result<Vec<Ray>> {
    ensure!(!rays.is_empty(), "there are no rays to cast");
    rays.iter()
        .map(Ray::exactly)
        .collect::<Option<_>>()
        .context(BEYOND_SINGLE)
}

const BEYOND_SINGLE: &str = "a coordinate of this number format is none of single precision, in which Embree computes; \
     choose a format of at most 8 exponent bits";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_become_single_or_nothing() {
        assert_eq!(exactly([0.5, -3.0]), Some([0.5, -3.0]));
        assert_eq!(exactly([f64::INFINITY]), Some([f32::INFINITY]));
        assert_eq!(exactly([0.1]), None);
        assert_eq!(exactly([1e39]), None);
        assert!(vertices_exactly(&[[0.0, 1.0, 1e-50]]).is_err());
        assert!(rays_exactly(&[]).is_err());
    }
}
