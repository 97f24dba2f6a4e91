//! What the window shows, without the window itself: results, traces and choices.

use crate::error::{Error, Result};
use crate::model::photometry;
use crate::result::color::Color;
use crate::result::figures::field::{CellGeometry, Field};
use crate::result::figures::region::{EncircledEnergy, Region, Statistics};
use crate::result::output::REPORT;
use crate::result::picture::polar;
use crate::result::picture::pyramid::Pyramid;
use crate::result::picture::scale::{ColorMap, Scale, ScaleKind};
use crate::result::picture::true_color::TrueColors;
use crate::result::{Detector, DetectorData, PathColumns, SpectralMap, TraceResult};
use crate::viewer::light::{Context, Light, RaysOfPaths};
use crate::viewer::line_profile::Line;
use crate::viewer::settings::Settings;
use crate::viewer::spots::{SpotFigures, Spots};
use crate::viewer::stray::Stray;
use crate::viewer::tracing::{
    Background, Device, Job, LoadedScene, Notify, PathsJob, RunOptions, State, record_paths,
};
use crate::viewer::two_results::{ComparisonMode, Scores, difference};
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

/// What the middle of the window shows.
#[derive(Debug, Clone, PartialEq)]
pub enum Subject {
    /// The detector of this name.
    Detector(String),
    /// The scene from the side, with rays.
    Scene,
}

/// What the user marked in one plot.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Marks {
    /// Region of the figures; `None` for the whole plot.
    pub region: Option<Region>,
    /// Line of the profile; `None` for a line along x through the middle.
    pub line: Option<Line>,
    /// Point that is read while the pointer is not over the plot.
    pub pin: Option<(f64, f64)>,
}

/// A picture of the detector that is shown.
#[derive(Debug, Clone, PartialEq)]
pub enum Picture {
    /// Values over a plane.
    Map {
        /// The values.
        field: Box<Field>,
        /// The values at coarser resolutions.
        pyramid: Pyramid,
        /// The colours of the values.
        scale: Scale,
        /// The colours of its light, if they are shown.
        colors: Option<Box<TrueColors>>,
        /// The other of two results, which profiles show, too.
        other: Option<Box<Field>>,
        /// How significant a difference is.
        scores: Option<Scores>,
    },
    /// Rays as points.
    Spots(Spots),
}

/// Figures of a region.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RegionFigures {
    /// Figures of a map; `None` if no cell lies in the region.
    Map(Option<Statistics>),
    /// Figures of rays.
    Spots(SpotFigures),
}

/// Figures of a region, and how its flux is spread around the centroid.
pub type Analysis = (RegionFigures, Option<EncircledEnergy>);

impl Picture {
    /// Figures of a region, or of everything shown without a region.
    pub fn analysis(&self, region: Option<Region>) -> Analysis {
        match self {
            Picture::Map { field, .. } => {
                let region = region.unwrap_or_else(|| Region::whole(field));
                (RegionFigures::Map(region.statistics(field)), region.encircled_energy(field))
            }
            Picture::Spots(spots) => (
                RegionFigures::Spots(spots.figures(region.as_ref())),
                spots.encircled_energy(region.as_ref()),
            ),
        }
    }
}

/// A result for comparison.
pub struct Reference {
    /// The name of the result.
    pub name: String,
    /// The result.
    pub result: Arc<TraceResult>,
}

/// The rays of the side view.
enum Paths {
    /// The user has not looked at the side view yet.
    NotAsked,
    /// The rays are being traced.
    Recording(PathsJob),
    /// The rays are recorded.
    Recorded(Arc<PathColumns>),
    /// The rays could not be traced.
    Failed,
}

/// All that determines a picture.
#[derive(Debug, Clone, PartialEq)]
struct PictureKey {
    revision: u64,
    /// The light that is shown of A.
    light: u64,
    detector: String,
    bin: Option<usize>,
    settings: Settings,
    wavelength: f64,
}

/// The data from which a picture is made.
#[derive(Clone)]
struct Recipe {
    key: PictureKey,
    a: Arc<TraceResult>,
    b: Option<Arc<TraceResult>>,
    /// What is shown in the place of A's detector: the light of some paths.
    light: Option<Arc<Detector>>,
}

/// A picture, or why there is none, and the key for which it was made.
struct Made {
    key: PictureKey,
    picture: std::result::Result<Arc<Picture>, String>,
    analysis: Option<Analysis>,
}

impl Recipe {
    /// True if the picture can be made well within a frame.
    fn is_small(&self) -> bool {
        const CELLS: u64 = 300_000;
        let size =
            self.a.detector(&self.key.detector).map_or(0, |detector| detector.data.result().num_items());
        size < CELLS
    }

    fn make(&self) -> Made {
        let picture = self.picture().map(Arc::new);
        let analysis = picture.as_ref().ok().map(|picture| picture.analysis(None));
        Made { key: self.key.clone(), picture, analysis }
    }

    fn picture(&self) -> std::result::Result<Picture, String> {
        let of = |result: &TraceResult, which: &str| {
            let detector = result.detector(&self.key.detector);
            detector.cloned().ok_or_else(|| format!("{which} has no detector '{}'", self.key.detector))
        };
        let a = match &self.light {
            Some(light) => light.as_ref().clone(),
            None => of(&self.a, "A")?,
        };
        let Some(b) = &self.b else {
            return self.alone(&a, None);
        };
        let b = of(b, "B");
        match self.key.settings.comparison {
            ComparisonMode::A => self.alone(&a, b.as_ref().ok()),
            ComparisonMode::B => self.alone(&b?, Some(&a)),
            comparison => {
                let (a, b) = (self.field(&a)?, self.field(&b?)?);
                let field = difference(comparison, &a, &b)?;
                let Settings { scale, percentile, .. } = self.key.settings;
                let scale = Scale::fit_difference(scale, percentile, &field.values);
                let scores = Some(Scores::of(&field));
                let pyramid = pyramid_of(&field);
                Ok(Picture::Map { field: Box::new(field), pyramid, scale, colors: None, other: None, scores })
            }
        }
    }

    fn alone(&self, detector: &Detector, other: Option<&Detector>) -> std::result::Result<Picture, String> {
        if let DetectorData::RayDatabase(rays) = &detector.data {
            let spots = Spots::new(rays, self.key.settings.directions, self.key.settings.photometric);
            return spots.map(Picture::Spots).map_err(|error| error.to_string());
        }
        let field = self.field(detector)?;
        let other = other.and_then(|other| self.field(other).ok()).map(Box::new);
        let Settings { scale, percentile, common_scale, .. } = self.key.settings;
        let scaled_with = other.as_ref().filter(|_| common_scale);
        let values = std::iter::once(&field.values).chain(scaled_with.map(|other| &other.values));
        let scale = Scale::fit(scale, percentile, values);
        let pyramid = pyramid_of(&field);
        let colors = self.true_colors(detector, &field).map(Box::new);
        Ok(Picture::Map { field: Box::new(field), pyramid, scale, colors, other, scores: None })
    }

    /// True if true colours are asked for, and all results that are shown have them.
    fn shows_true_colors(&self) -> bool {
        let sees = |result: &TraceResult| result.detector(&self.key.detector).and_then(color_of).is_some();
        let all_see = sees(&self.a) && self.b.as_deref().is_none_or(sees);
        self.key.settings.color_map == ColorMap::TrueColor && all_see
    }

    /// The colours of a detector's light, if they are asked for and known: of the cells of its field.
    fn true_colors(&self, detector: &Detector, field: &Field) -> Option<TrueColors> {
        let color = color_of(detector).filter(|_| self.shows_true_colors())?;
        let mut colors = TrueColors::of(color)?;
        if matches!(detector.data, DetectorData::FarField(_)) {
            colors = colors.changed(|map| polar::in_equal_solid_angles(map, &field.measure));
        }
        // A disc is drawn cell by cell.
        Some(if field.geometry == CellGeometry::Polar { colors } else { colors.with_pyramids() })
    }

    /// The values of a detector, by the settings.
    fn field(&self, detector: &Detector) -> std::result::Result<Field, String> {
        let Settings { photometric, polar, .. } = self.key.settings;
        // A detector that sees colour is as bright as the eye sees its light.
        let photometric = photometric || self.shows_true_colors();
        if let DetectorData::Spectral(map) = &detector.data {
            return self.spectral_field(map);
        }
        // Any other kind is shown as its map says.
        let is_known = photometric && detector.luminous.is_some();
        let field = match is_known {
            true => Field::of_detector(detector),
            false => detector.data.result().map().and_then(|map| Field::of_map(&map)),
        };
        let field = field.ok_or("rays are shown as points: A and B cannot be subtracted")?;
        let field = match &detector.data {
            DetectorData::FarField(_) if polar => field.as_disc().of_equal_solid_angles(),
            DetectorData::FarField(_) => field.of_equal_solid_angles(),
            DetectorData::Irradiance(_) | DetectorData::Spectral(_) | DetectorData::RayDatabase(_) => field,
        };
        if !photometric || is_known {
            return Ok(field);
        }
        let efficacy = photometry::efficacy(self.key.wavelength);
        if !photometry::is_visible(efficacy) {
            return Err(format!(
                "the eye sees nothing at {} µm: there are no lumens to show",
                self.key.wavelength
            ));
        }
        Ok(field.photometric(efficacy))
    }

    fn spectral_field(&self, map: &SpectralMap) -> std::result::Result<Field, String> {
        let shown = |bin: usize| self.key.bin.is_none_or(|shown| shown == bin);
        let weight = |(bin, &wavelength): (usize, &f64)| match (shown(bin), self.key.settings.photometric) {
            (false, _) => 0.0,
            (true, false) => 1.0,
            (true, true) => photometry::efficacy(wavelength),
        };
        let weights: Vec<f64> = map.wavelengths.iter().enumerate().map(weight).collect();
        if self.key.settings.photometric {
            if !weights.iter().any(|weight| photometry::is_visible(*weight)) {
                return Err("the eye sees none of these wavelengths: there are no lumens to show".into());
            }
            return Ok(Field::of_spectral(map, &weights).photometric(1.0));
        }
        Ok(Field::of_spectral(map, &weights))
    }
}

/// The colour that a detector saw.
fn color_of(detector: &Detector) -> Option<&Color> {
    detector.luminous.as_ref()?.color.as_ref()
}

/// The pyramid of a field. A disc has none, because it is drawn cell by cell.
fn pyramid_of(field: &Field) -> Pyramid {
    match field.geometry {
        CellGeometry::Rectangles => Pyramid::of(&field.values),
        CellGeometry::Polar => Pyramid::default(),
    }
}

/// The state of the viewer.
pub struct Model {
    /// The user's choices, which are kept between starts.
    pub settings: Settings,
    /// The name of what was opened.
    pub title: String,
    /// The options of the next trace.
    pub run: RunOptions,
    /// What is shown.
    pub subject: Subject,
    /// Wavelength bin of a spectral detector; `None` for all bins.
    pub bin: Option<usize>,
    /// Wavelength for converting watts to lumens, where a detector does not resolve wavelengths \[um\].
    pub wavelength: f64,
    /// Messages about failures and finished work, the latest last.
    pub messages: Vec<String>,
    /// Why the last trace failed.
    pub failure: Option<Error>,
    /// Light by its path.
    pub light: Light,
    /// Surfaces that are to blame for stray light.
    pub stray: Stray,
    scene: Option<Arc<LoadedScene>>,
    a: Option<Arc<TraceResult>>,
    b: Option<Reference>,
    device: Device,
    job: Option<Job>,
    paths: Paths,
    notify: Notify,
    marks: HashMap<String, Marks>,
    /// Grows with every new result.
    revision: u64,
    made: Option<Made>,
    making: Option<Background<Made>>,
}

/// Rays of the side view.
const NUM_PATHS: u64 = 300;

impl Model {
    /// Opens a scene file, which is traced at once, or a folder of results.
    ///
    /// # Errors
    /// [`Error::Scene`] if the scene cannot be traced, [`Error::File`] if something cannot be read.
    pub fn open(path: &Path, settings: Settings, device: Device, notify: Notify) -> Result<Self> {
        let mut model = Model {
            settings,
            title: path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned(),
            run: RunOptions::default(),
            subject: Subject::Scene,
            bin: None,
            wavelength: 0.555,
            messages: Vec::new(),
            failure: None,
            light: Light::default(),
            stray: Stray::default(),
            scene: None,
            a: None,
            b: None,
            device,
            job: None,
            paths: Paths::NotAsked,
            notify,
            marks: HashMap::new(),
            revision: 0,
            made: None,
            making: None,
        };
        if path.is_dir() || path.file_name().is_some_and(|name| name == REPORT) {
            model.open_results(if path.is_dir() { path } else { path.parent().unwrap_or(path) })?;
        } else {
            let scene = LoadedScene::read(path)?;
            model.run = RunOptions::of(&scene.ir);
            model.scene = Some(Arc::new(scene));
        }
        model.subject = model.first_detector().map_or(Subject::Scene, Subject::Detector);
        if let Some([wavelength]) = model.scene.as_ref().map(|scene| scene.ir.wavelengths.as_slice()) {
            model.wavelength = *wavelength;
        }
        Ok(model)
    }

    fn open_results(&mut self, dir: &Path) -> Result<()> {
        let result = TraceResult::read(dir)?;
        if result.run.is_unchecked {
            self.messages.push(result.run.unchecked_notice(dir));
        }
        self.run = RunOptions {
            num_rays: result.run.num_rays,
            seed: result.run.seed,
            max_depth: result.run.max_depth,
            target_error: result.run.target_error,
            ..RunOptions::default()
        };
        if let Some(path) = &result.run.scene {
            match LoadedScene::read(Path::new(path)) {
                Ok(scene) => self.scene = Some(Arc::new(scene)),
                Err(error) => {
                    self.messages
                        .push(format!("without its scene, the result cannot be traced anew: {error}"));
                }
            }
        }
        self.a = Some(Arc::new(result));
        Ok(())
    }

    fn first_detector(&self) -> Option<String> {
        self.detector_names().into_iter().next()
    }

    /// Shows a result.
    pub fn show(&mut self, result: TraceResult) {
        self.a = Some(Arc::new(result));
        self.revision += 1;
    }

    /// Names of the detectors, in the order of the scene.
    pub fn detector_names(&self) -> Vec<String> {
        match (&self.a, &self.scene) {
            (Some(result), _) => result.detectors.iter().map(|detector| detector.name.clone()).collect(),
            (None, Some(scene)) => scene.ir.detectors.iter().map(|detector| detector.name.clone()).collect(),
            (None, None) => Vec::new(),
        }
    }

    /// The scene, if it is known.
    pub fn scene(&self) -> Option<&LoadedScene> {
        self.scene.as_deref()
    }

    /// The result that was opened or is being traced.
    pub fn a(&self) -> Option<&TraceResult> {
        self.a.as_deref()
    }

    /// The result for comparison.
    pub fn b(&self) -> Option<&Reference> {
        self.b.as_ref()
    }

    /// Grows whenever a result changes.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Begins to trace with [`Model::run`]. A trace that is running ends.
    pub fn trace(&mut self) {
        if let Some(scene) = &self.scene {
            self.job = Some(Job::start(&self.device, scene, &self.run, self.notify.clone()));
            self.light.forget();
        }
    }

    /// The present or last trace.
    pub fn job(&self) -> Option<&Job> {
        self.job.as_ref()
    }

    /// Takes the latest results from the tracing threads, without waiting.
    pub fn poll(&mut self) {
        if let Some(job) = &self.job {
            if let Some(result) = job.take_result() {
                self.a = Some(result);
                self.revision += 1;
            }
            if let State::Failed(error) = job.state() {
                self.messages.push(error.to_string());
                self.failure = Some(error);
                self.job = None;
            }
        }
        if let Some(context) = self.context() {
            self.light.poll(&context, self.listed_detector());
        }
        self.stray.poll();
        if let Paths::Recording(job) = &self.paths
            && let Some(paths) = job.take()
        {
            self.paths = match paths {
                Ok(paths) => Paths::Recorded(paths),
                Err(error) => {
                    self.messages.push(error.to_string());
                    Paths::Failed
                }
            };
        }
    }

    /// Begins the list of surfaces that are to blame for the stray light of a detector.
    pub fn ask_for_stray(&mut self, detector: &str) {
        if let Some(context) = self.context() {
            self.stray.ask(&context, detector);
        }
    }

    /// What background work needs. `None` if no scene is open.
    fn context(&self) -> Option<Context> {
        let scene = self.scene.clone()?;
        let (device, run, notify) = (self.device.clone(), self.run.clone(), self.notify.clone());
        Some(Context { device, scene, run, notify })
    }

    /// Begins to sum up light by its path, for the table of the panel.
    pub fn follow_light(&mut self) {
        if let Some(context) = self.context() {
            self.light.follow(&context);
        }
    }

    /// The number of the detector that is shown, in the scene.
    fn shown_detector(&self) -> Option<usize> {
        let Subject::Detector(name) = &self.subject else { return None };
        self.scene.as_ref()?.ir.detectors.iter().position(|detector| detector.name == *name)
    }

    /// The number of the detector whose light is listed: in the side view, of the last detector that was shown.
    fn listed_detector(&self) -> Option<usize> {
        let last = || self.light.listing().map(|listing| listing.detector);
        self.shown_detector().or_else(last).or(Some(0))
    }

    /// The light of some paths, if it is shown in the place of the detector.
    pub fn shown_light(&self) -> Option<&Detector> {
        self.light.detector(self.shown_detector()).map(Arc::as_ref)
    }

    /// The rays of the light that is shown, for the side view; none for all light.
    pub fn light_rays(&mut self) -> Option<RaysOfPaths> {
        let context = self.context()?;
        self.light.rays(&context)
    }

    /// Paths of a few rays, which are recorded when they are first asked for.
    pub fn paths(&mut self) -> Option<Arc<PathColumns>> {
        match (&self.paths, &self.scene) {
            (Paths::NotAsked, Some(scene)) => {
                let notify = self.notify.clone();
                let job = record_paths(&self.device, scene, &self.run, NUM_PATHS, notify);
                self.paths = Paths::Recording(job);
                None
            }
            (Paths::Recorded(paths), _) => Some(paths.clone()),
            _ => None,
        }
    }

    /// True while no further result will come by itself.
    pub fn is_idle(&self) -> bool {
        self.job.as_ref().is_none_or(|job| !job.is_running())
            && !matches!(self.paths, Paths::Recording(_))
            && self.making.is_none()
            && self.light.is_idle()
            && !self.stray.is_asked()
    }

    /// Compares with the results in a folder.
    ///
    /// # Errors
    /// [`Error::File`] if they cannot be read.
    pub fn compare_with(&mut self, dir: &Path) -> Result<()> {
        let result = Arc::new(TraceResult::read(dir)?);
        self.set_reference(dir.display().to_string(), result);
        Ok(())
    }

    /// Keeps the present result as B, to compare the next one with it.
    pub fn hold_as_b(&mut self) {
        if let Some(result) = self.a.clone() {
            let name = format!("{} rays, seed {}", count(result.num_rays_total), result.run.seed);
            self.set_reference(name, result);
        }
    }

    fn set_reference(&mut self, name: String, result: Arc<TraceResult>) {
        self.b = Some(Reference { name, result });
        self.revision += 1;
    }

    /// Ends the comparison.
    pub fn drop_b(&mut self) {
        self.b = None;
        self.settings.comparison = ComparisonMode::A;
        self.revision += 1;
    }

    /// The detector that is shown: of B if only B is shown, else of A.
    pub fn detector(&self) -> Option<&Detector> {
        let Subject::Detector(name) = &self.subject else {
            return None;
        };
        match (self.settings.comparison, &self.b) {
            (ComparisonMode::B, Some(b)) => b.result.detector(name),
            _ => self.shown_light().or_else(|| self.a.as_ref()?.detector(name)),
        }
    }

    /// The spectral map that is shown.
    pub fn spectral(&self) -> Option<&SpectralMap> {
        match &self.detector()?.data {
            DetectorData::Spectral(map) => Some(map),
            _ => None,
        }
    }

    /// The user's marks in the plot that is shown. Each way of plotting has its own marks.
    pub fn marks(&mut self) -> &mut Marks {
        let name = match &self.subject {
            Subject::Detector(name) => name.as_str(),
            Subject::Scene => "",
        };
        let Settings { polar, directions, .. } = self.settings;
        let key = match self.detector().map(|detector| &detector.data) {
            Some(DetectorData::FarField(_)) => format!("{name} polar {polar}"),
            Some(DetectorData::RayDatabase(_)) => format!("{name} directions {directions}"),
            _ => name.to_string(),
        };
        self.marks.entry(key).or_default()
    }

    /// The picture of the detector that is shown. A picture is made anew only after a change. A large one is made in
    /// the background, while the previous one is still shown.
    ///
    /// # Errors
    /// Why there is no picture.
    pub fn picture(&mut self) -> std::result::Result<Arc<Picture>, String> {
        self.made()?.picture.clone()
    }

    /// Figures of the whole picture.
    pub fn analysis(&mut self) -> Option<Analysis> {
        self.made().ok()?.analysis.clone()
    }

    fn made(&mut self) -> std::result::Result<&Made, String> {
        let recipe = self.recipe()?;
        if let Some(made) = self.making.as_ref().and_then(Background::take) {
            (self.made, self.making) = (Some(made), None);
        }
        if self.made.as_ref().is_none_or(|made| made.key != recipe.key) {
            if recipe.is_small() {
                (self.made, self.making) = (Some(recipe.make()), None);
            } else if self.making.is_none() {
                let recipe = recipe.clone();
                self.making = Some(Background::start(move || recipe.make(), self.notify.clone()));
            }
        }
        let of_this_detector = |made: &&Made| made.key.detector == recipe.key.detector;
        self.made.as_ref().filter(of_this_detector).ok_or_else(|| "the picture is being made".into())
    }

    fn recipe(&self) -> std::result::Result<Recipe, String> {
        let Subject::Detector(name) = &self.subject else {
            return Err("no detector is shown".into());
        };
        let key = PictureKey {
            revision: self.revision,
            light: self.light.revision(),
            detector: name.clone(),
            bin: self.bin,
            settings: self.settings.of_pictures(),
            wavelength: self.wavelength,
        };
        let a = self.a.clone().ok_or("the first rays are on their way")?;
        let light = self.light.detector(self.shown_detector()).cloned();
        Ok(Recipe { key, a, b: self.b.as_ref().map(|b| b.result.clone()), light })
    }

    /// The command that traces with the same options.
    pub fn command(&self) -> String {
        let Some(scene) = &self.scene else {
            return format!("nsq-gpu view {}", quoted(&self.title));
        };
        let RunOptions { num_rays, seed, max_depth, precision, target_error, time_limit, filter } = &self.run;
        let target =
            target_error.map_or(String::new(), |error| format!(" --target-error {}%", 100.0 * error));
        let limit =
            time_limit.map_or(String::new(), |limit| format!(" --time-limit {}s", limit.as_secs_f64()));
        let precision = precision.map_or("auto", crate::program::Precision::name);
        let filter =
            filter.as_ref().map_or(String::new(), |filter| format!(" --where {}", quoted(&filter.text)));
        let guide = if crate::viewer::tracing::is_guided(scene, &self.run) { " --guide" } else { "" };
        let path = quoted(&scene.path.display().to_string());
        format!(
            "nsq-gpu trace {path} -n {num_rays} --seed {seed} --max-depth {max_depth} --precision {precision}{target}{limit}{filter}{guide} \
             --standard-error on -o results"
        )
    }

    /// Adds a message about what was done, or why it failed.
    pub fn report<T>(&mut self, outcome: Result<T>, done: impl FnOnce(T) -> String) {
        self.messages.push(outcome.map_or_else(|error: Error| error.to_string(), done));
    }
}

/// Background work ends first, because a device must not be in use when the process ends.
impl Drop for Model {
    fn drop(&mut self) {
        if let Some(job) = self.job.take() {
            job.finish();
        }
        self.light.finish();
        self.stray.finish();
        if let Paths::Recording(job) = std::mem::replace(&mut self.paths, Paths::NotAsked) {
            job.finish();
        }
    }
}

/// A word of a command line, quoted if needed.
fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./\\:".contains(c);
    if word.chars().all(plain) { word.into() } else { format!("'{}'", word.replace('\'', r"'\''")) }
}

/// A count as people write it.
pub fn count(count: u64) -> String {
    crate::format::thousands(count)
}

impl Settings {
    /// The settings that change the values or the scale of a picture.
    fn of_pictures(&self) -> Settings {
        let Settings { scale, common_scale, comparison, photometric, polar, directions, color_map, .. } =
            *self;
        let is_true = color_map == ColorMap::TrueColor;
        let percentile = if scale == ScaleKind::Percentile { self.percentile } else { 0.0 };
        Settings {
            scale,
            percentile,
            common_scale,
            comparison,
            photometric,
            polar,
            directions,
            color_map: if is_true { color_map } else { Settings::default().color_map },
            ..Settings::default()
        }
    }
}
