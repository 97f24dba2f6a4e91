//! Scene text -> a [`Scene`] that is proven valid.
//!
//! The way of a scene: text -> tree of JSON values -> typed [`json::SceneFile`] -> validated scene. Then components
//! become surfaces, closed and in order, and media become tables over the wavelengths of the sources.

mod coatings;
mod coincidence;
mod compounds;
#[allow(clippy::wildcard_enum_match_arm, reason = "JSON's kinds of values are not the scene's")]
mod de;
pub(crate) mod detectors;
mod elements;
mod frame;
pub mod json;
mod json_text;
#[allow(clippy::wildcard_enum_match_arm, reason = "JSON's kinds of values are not the scene's")]
mod json_tree;
pub mod lamp_files;
pub mod lamps;
mod lower;
pub mod materials;
mod media;
mod mesh_files;
mod meshes;
#[allow(clippy::wildcard_enum_match_arm, reason = "JSON's kinds of values are not the scene's")]
pub(crate) mod named_entries;
pub mod notes;
#[allow(clippy::wildcard_enum_match_arm, reason = "JSON's kinds of values are not the scene's")]
pub(crate) mod parameters;
pub mod path_expression;
pub mod ray_files;
mod ray_sources;
mod scatter_policy;
mod surfaces;
pub(crate) mod units;
mod validate;
mod volume;
mod warnings;

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::format::path_text;
use crate::model::key_path::{quoted, ticked};
use crate::model::sources::rays::RayFileUsed;
use crate::model::sources::tabulated::LampFile;
use crate::model::{Mesh, Precision, whole_files};
use crate::scene::json::SceneFile;
pub use crate::scene::lower::GuidedLight;
pub(crate) use crate::scene::media::MediaTable;
pub(crate) use crate::scene::surfaces::SceneSurface;
use crate::{Error, Result};

/// The version of Optiland's schema that is read.
pub const NSQ_SCHEMA_VERSION: u64 = 1;

/// The version of the `nsq_gpu` block that is read.
pub const BLOCK_VERSION: u64 = 1;

/// A scene that is proven valid and can be traced.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// What the user wrote.
    pub file: SceneFile,
    /// What the user should know, such as an ambiguous material name.
    pub warnings: Vec<String>,
    /// What the user should know where the scene is traced in f32.
    pub f32_warnings: Vec<String>,
    /// Folder that relative paths in the file start from; empty for a scene that was not read from a file.
    pub folder: PathBuf,
    /// The lamp files whose tables are in `file`.
    pub lamp_files: Vec<LampFile>,
    /// The ray files whose rays are in `file`.
    pub ray_files: Vec<RayFileUsed>,
    pub(crate) wavelengths: Vec<f64>,
    pub(crate) surfaces: Vec<SceneSurface>,
    pub(crate) meshes: Vec<Mesh>,
    pub(crate) media: MediaTable,
}

/// Ends of the names of lens files: of Zemax, CODE V and OSLO.
const PRESCRIPTIONS: [&str; 3] = ["zmx", "seq", "len"];
/// Ends of the names of lamps' files.
const LAMPS: [&str; 2] = ["ies", "ldt"];

impl Scene {
    /// Reads a scene file. Files that it names are looked for from its folder.
    ///
    /// # Errors
    /// [`Error::File`] if it cannot be read, [`Error::Scene`] with the place if it cannot be traced as written.
    pub fn from_path(path: &Path) -> Result<Self> {
        let text = Self::text(path)?;
        Self::read(&text, path.parent().unwrap_or(Path::new("")))
    }

    /// The text of a scene file. One that is too long, or no file at all, is refused before it is read.
    ///
    /// # Errors
    /// [`Error::File`] if it cannot be read, [`Error::Scene`] if it is no text.
    pub fn text(path: &Path) -> Result<String> {
        let bytes =
            whole_files::read(path, json_text::MAX_BYTES as u64).map_err(|err| Error::file(path, err))?;
        let end = path.extension().and_then(|end| end.to_str()).unwrap_or_default();
        let is_one_of = |ends: &[&str]| ends.iter().any(|known| known.eq_ignore_ascii_case(end));
        if is_one_of(&PRESCRIPTIONS) {
            let command = format!("python -m nsq_gpu.convert {} -o scene.json", path_text(path));
            return Err(Error::file(
                path,
                format!("it is a lens, no scene; `{command}` makes a scene of it"),
            ));
        }
        if is_one_of(&LAMPS) {
            let problem = "it is a lamp's file, no scene; `nsq-gpu lamp` reads it, and a source of type tabulated names it as its `file`";
            return Err(Error::file(path, problem));
        }
        String::from_utf8(bytes).map_err(|err| {
            let at = err.utf8_error().valid_up_to();
            Error::scene(format!("byte {at}"), "the scene file is not UTF-8 text", "save it as UTF-8")
        })
    }

    /// Reads a scene from JSON or JSON5 text.
    ///
    /// # Errors
    /// [`Error::Scene`] with the place if it cannot be traced as written.
    pub fn from_json(text: &str) -> Result<Self> {
        Self::read(text, Path::new(""))
    }

    /// As [`Scene::from_json`], with some numbers set to other values, by names such as `L1.r1`, `L4.rx` or `gap_3`. Files that the
    /// scene names are looked for from a folder.
    ///
    /// # Errors
    /// [`Error::Scene`] with the place if it cannot be traced as written, [`Error::Usage`] for a name of nothing, and for
    /// a number that is set twice.
    pub fn with_numbers(text: &str, folder: &Path, numbers: &[(String, f64)]) -> Result<Self> {
        let mut tree = json_text::parse(text)?;
        parameters::set_all(&mut tree, numbers)?;
        Self::of_tree(&tree, folder)
    }

    /// The numbers of these names in a scene's text.
    ///
    /// # Errors
    /// [`Error::Scene`] if the text is no JSON, [`Error::Usage`] for a name of nothing.
    pub fn numbers(text: &str, names: &[String]) -> Result<Vec<f64>> {
        let tree = json_text::parse(text)?;
        let number = |name: &String| {
            parameters::get(&tree, name).or_else(|error| {
                // A key that is misspelt has a better word than one that the file leaves out.
                let mut changed = tree.clone();
                parameters::set_all(&mut changed, &[(name.clone(), 1.0)])?;
                de::typed::<SceneFile>(&changed)?;
                Err(error)
            })
        };
        names.iter().map(number).collect()
    }

    /// The name of a medium that is a table over wavelengths, if the scene uses one.
    pub(crate) fn tabulated_medium(&self) -> Option<String> {
        media::tabulated(&self.file)
    }

    fn read(text: &str, folder: &Path) -> Result<Self> {
        Self::of_tree(&json_text::parse(text)?, folder)
    }

    fn of_tree(tree: &json_tree::Value, folder: &Path) -> Result<Self> {
        check_versions(tree)?;
        let mut file: SceneFile = de::typed(tree)?;
        let mut warnings = Vec::new();
        let lamp_files = lamp_files::fill(&mut file, folder, &mut warnings)?;
        let ray_files = ray_sources::fill(&mut file, folder, &mut warnings)?;
        validate::check(&file, &mut warnings)?;
        let wavelengths = distinct_wavelengths(&file);
        let meshes = meshes::Meshes::load(&file, folder, &mut warnings)?;
        let surfaces = surfaces::build(&file, &wavelengths, &meshes, folder, &mut warnings)?;
        let media = media::resolve(&file, &wavelengths, &mut warnings)?;
        let meshes = meshes.meshes;
        warnings.extend(warnings::of(&file, &surfaces, &meshes, &media, &wavelengths));
        let warnings = warnings::grouped(warnings);
        let (f32_warnings, folder) = (warnings::grouped(warnings::of_f32(&surfaces)), folder.to_owned());
        Ok(Scene {
            file,
            warnings,
            f32_warnings,
            folder,
            lamp_files,
            ray_files,
            wavelengths,
            surfaces,
            meshes,
            media,
        })
    }

    /// True if some source says its flux in lumens or its intensity in candela, or some detector sees colour.
    pub fn is_photometric(&self) -> bool {
        self.file.sources.iter().any(|source| source.total_flux_lumens().is_some())
            || !self.color_detectors().is_empty()
    }

    /// The names of detectors that see colour.
    pub fn color_detectors(&self) -> Vec<String> {
        let colored = self.file.detectors.iter().filter(|detector| detector.sees_color());
        colored.map(|detector| detector.name().to_owned()).collect()
    }

    /// The warnings of a trace in this precision.
    pub fn warnings_in(&self, precision: Precision) -> Vec<String> {
        let of_f32 = if precision == Precision::F32 { &self.f32_warnings[..] } else { &[] };
        [&self.warnings, of_f32].concat()
    }

    /// A path that the scene names, such as the file of a mesh.
    pub fn resolve(&self, named: &str) -> PathBuf {
        self.folder.join(named)
    }
}

/// The JSON Schema of scene files.
pub fn schema() -> Value {
    let mut schema = schemars::schema_for!(SceneFile).into();
    unescape(&mut schema);
    schema
}

/// The descriptions come from the code's documentation, where brackets are escaped.
fn unescape(schema: &mut Value) {
    match schema {
        Value::String(text) => *text = text.replace("\\[", "[").replace("\\]", "]"),
        Value::Array(items) => items.iter_mut().for_each(unescape),
        Value::Object(entries) => entries.values_mut().for_each(unescape),
        Value::Null | Value::Bool(_) | Value::Number(_) => {}
    }
}

/// Versions come first, so that a file of another version is not blamed for its keys.
fn check_versions(tree: &json_tree::Value) -> Result<()> {
    let Some(object) = tree.object() else {
        return Err(Error::scene("the scene file", "it does not hold an object", "write { ... }"));
    };
    let Some(version) = object.get("nsq_schema_version") else {
        return Err(Error::scene(
            "the scene file",
            "the key `nsq_schema_version` is missing, so this may be no Optiland NSQ scene",
            format!("save it with NSQScene.to_json, or add `\"nsq_schema_version\": {NSQ_SCHEMA_VERSION}`"),
        ));
    };
    check_version("nsq_schema_version", version, NSQ_SCHEMA_VERSION)?;
    let block = object.get("nsq_gpu").and_then(json_tree::Value::object);
    match block.and_then(|block| block.get("version")) {
        Some(version) => check_version("nsq_gpu.version", version, BLOCK_VERSION),
        None => Ok(()),
    }
}

fn check_version(place: &str, found: &json_tree::Value, read: u64) -> Result<()> {
    let found = match found {
        // Optiland, too, takes 1.0 for 1.
        json_tree::Value::Number(number) if number.as_f64() == Some(read as f64) => return Ok(()),
        json_tree::Value::Number(number) => ticked(&number.to_string()),
        json_tree::Value::String(text) => quoted(text),
        json_tree::Value::Null
        | json_tree::Value::Bool(_)
        | json_tree::Value::Array(_)
        | json_tree::Value::Object(_) => "of another kind".to_owned(),
    };
    Err(Error::scene(
        place,
        format!("the file has version {found}, this program reads version {read}"),
        "save the scene again with a matching program",
    ))
}

/// Every wavelength that some source emits, ascending \[um\].
fn distinct_wavelengths(file: &SceneFile) -> Vec<f64> {
    let mut all: Vec<f64> =
        file.sources.iter().flat_map(|source| source.spectrum().wavelengths.iter().copied()).collect();
    all.sort_by(f64::total_cmp);
    all.dedup();
    all
}
