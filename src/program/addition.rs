//! What an addition to the plain loop asks of a program. The host's half of an addition is `engine::Addition`.
//!
//! The parts of an addition, from the loop down to the text:
//!
//! ```text
//! engine::addition::Addition   what it does in a trace: buffers, drains, stages of its own
//!   is a ProgramAddition       what it asks of the program of any scene: options, cells
//!     gives a ShaderAddition   its WGSL for one scene: files in slots, text, an entry point
//! ```
//!
//! Lists of them are `engine::addition::Additions` and [`ShaderAdditions`], which each program keeps. Options are
//! changed in this order. First comes `Addition::specialise`, which knows the device. Then comes
//! [`ProgramAddition::prepare`], which knows the features. Then the program is composed, and `Addition::pack` adds
//! buffers to it.
//!
//! The plain program is complete without additions, and traces every scene. An addition may take the place of the file
//! of a slot ([`crate::program::wgsl::variants`]), and may add constants, functions and entry points. The composition
//! calls no addition by name: features and options pick the plain file of a slot, which may be one of shaders/cpu. What
//! the composition keeps for additions is listed in docs/internals/engine.md: cells, bindings, options.

use crate::error::{Error, Result};
use crate::program::features::Features;
use crate::program::input::ProgramInput;
use crate::program::layout::tables::Cells;
use crate::program::options::ProgramOptions;
use crate::program::wgsl::composition::Composition;
use crate::program::wgsl::text::Text;
use crate::shaders::ShaderFile;
use naga::{Module, Scalar};
use std::any::Any;
use std::fmt::Debug;
use std::sync::Arc;

/// What an addition asks of the program of any scene.
pub trait ProgramAddition: Sync {
    /// Changes how the program is specialised, now that the features of the scene are known.
    fn adapt_options(&self, features: &Features, options: &mut ProgramOptions) {
        let _ = (features, options);
    }

    /// Adds cells to the cells of a scene.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if there are too many to number.
    fn cells(&self, cells: Cells) -> Result<Cells> {
        Ok(cells)
    }

    /// True if the device must sum weights even where a count of rays would give their sum.
    fn sums_weights(&self) -> bool {
        false
    }

    /// True if the addition draws branches with probabilities of its own. Weights then change.
    fn draws_branches(&self) -> bool {
        false
    }

    /// The WGSL for a scene.
    fn shader(&self, scene: &ProgramInput) -> Arc<dyn ShaderAddition>;
}

/// The WGSL that an addition gives to the module of a scene. A method that is not overridden leaves the plain module as
/// it is.
pub trait ShaderAddition: Debug + Any + Send + Sync {
    /// Files that take the place of slots' own. A slot is named by its stem, such as `sums/ends`. A scene that does not
    /// fill a slot does not take its file; a name that is no slot's is an error.
    fn replaces(&self) -> Vec<(&'static str, ShaderFile)> {
        Vec::new()
    }

    /// Adds constants, files and entry points, with comments that name their origin.
    ///
    /// # Errors
    /// [`crate::Error::Usage`] if the precision cannot hold a number.
    fn add(&self, composition: &Composition, text: &mut Text) -> Result<()> {
        let _ = (composition, text);
        Ok(())
    }

    /// Statements with which every entry point begins, before its first branch.
    fn begin(&self) -> &'static str {
        ""
    }

    /// The entry point that follows new rays, in the place of the plain one.
    fn entry_point(&self) -> Option<&'static str> {
        None
    }

    /// Most rows for the host that one launched ray makes, beside the rows of the plain loop.
    fn rows_per_ray(&self, max_depth: u32) -> u64 {
        let _ = max_depth;
        0
    }

    /// Rewrites the parsed module. Gives the module and its text.
    ///
    /// # Errors
    /// [`crate::Error::Internal`] if the module has something that the rewriting does not know.
    fn rewrite(&self, module: &Module, real: Scalar) -> Result<Option<(Module, String)>> {
        let _ = (module, real);
        Ok(None)
    }

    /// True if the addition counts every event of a ray in sums of its own, which are read at the end of a range alone.
    fn counts_events_unread(&self) -> bool {
        false
    }

    /// True if a dispatch traces the rays of a list. The addition then uploads the rays of files with which they begin.
    fn lists_rays(&self) -> bool {
        false
    }

    /// True if deposits on detectors in passing are logged, and not added up by the device.
    fn logs_passes(&self) -> bool {
        false
    }

    /// True if the entry points take back what a ray has put into the bins since its birth (`keep_bins`,
    /// `restore_bins`).
    fn restores_bins(&self) -> bool {
        false
    }

    /// True if the bin of this mirror is kept in registers even where the scene lies in tables.
    fn keeps_bin_of(&self, primitive: usize) -> bool {
        let _ = primitive;
        false
    }
}

/// What all additions give to the module of a scene, in their order.
#[derive(Debug, Clone, Default)]
pub struct ShaderAdditions(Vec<Arc<dyn ShaderAddition>>);

impl ShaderAdditions {
    /// What these additions give to a scene.
    pub fn of(additions: &[&dyn ProgramAddition], scene: &ProgramInput) -> Self {
        ShaderAdditions(additions.iter().map(|addition| addition.shader(scene)).collect())
    }

    /// What the addition of this type gives, if it is among them.
    pub fn get<T: ShaderAddition>(&self) -> Option<&T> {
        self.all().find_map(|addition| (addition as &dyn Any).downcast_ref())
    }

    /// Each of them.
    pub fn all(&self) -> impl Iterator<Item = &dyn ShaderAddition> {
        self.0.iter().map(AsRef::as_ref)
    }

    /// True if one of them has a property.
    pub fn any(&self, has: impl Fn(&dyn ShaderAddition) -> bool) -> bool {
        self.all().any(has)
    }

    /// The files that take the places of slots' own, with the stems of the slots.
    pub fn replaced(&self) -> impl Iterator<Item = (&'static str, ShaderFile)> {
        self.all().flat_map(ShaderAddition::replaces)
    }

    /// The file that takes the place of a slot's own.
    ///
    /// # Errors
    /// [`Error::Internal`] if two additions want it for different files.
    pub fn file(&self, slot: &str) -> Result<Option<ShaderFile>> {
        let mut files = self.replaced().filter_map(|(stem, file)| (stem == slot).then_some(file));
        let first = files.next();
        match files.find(|file| first.is_some_and(|first| first.path != file.path)) {
            None => Ok(first),
            Some(file) => {
                Err(Error::Internal(format!("a second addition puts {} into the slot {slot}", file.path)))
            }
        }
    }

    /// The entry point that follows new rays, in the place of the plain one.
    ///
    /// # Errors
    /// [`Error::Internal`] if two additions have one.
    pub fn entry_point(&self) -> Result<Option<&'static str>> {
        let mut names = self.all().filter_map(ShaderAddition::entry_point);
        let first = names.next();
        match names.next() {
            None => Ok(first),
            Some(name) => Err(Error::Internal(format!("a second addition has an entry point, {name}"))),
        }
    }

    /// Most rows for the host that one launched ray makes, beside the rows of the plain loop.
    pub fn rows_per_ray(&self, max_depth: u32) -> u64 {
        self.all().map(|addition| addition.rows_per_ray(max_depth)).sum()
    }

    /// Rewrites the parsed module, if one of them does.
    ///
    /// # Errors
    /// As [`ShaderAddition::rewrite`], and [`Error::Internal`] if two of them do.
    pub fn rewrite(&self, module: &Module, real: Scalar) -> Result<Option<(Module, String)>> {
        let mut rewritten = self.all().filter_map(|addition| addition.rewrite(module, real).transpose());
        let first = rewritten.next().transpose()?;
        match rewritten.next() {
            None => Ok(first),
            Some(_) => Err(Error::Internal("a second addition rewrites the shader".into())),
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// An addition with an entry point, or that rewrites the module; with neither where both are false.
    #[derive(Debug)]
    struct Greedy {
        enters: bool,
        rewrites: bool,
    }

    impl ShaderAddition for Greedy {
        fn entry_point(&self) -> Option<&'static str> {
            self.enters.then_some("trace_greedily")
        }

        fn rewrite(&self, module: &Module, _: Scalar) -> Result<Option<(Module, String)>> {
            Ok(self.rewrites.then(|| (module.clone(), "rewritten".into())))
        }
    }

    fn additions(all: [[bool; 2]; 3]) -> ShaderAdditions {
        let greedy = |[enters, rewrites]: [bool; 2]| -> Arc<dyn ShaderAddition> {
            Arc::new(Greedy { enters, rewrites })
        };
        ShaderAdditions(all.map(greedy).into())
    }

    #[test]
    fn one_addition_alone_enters_and_one_alone_rewrites() {
        let module = Module::default();
        let one = additions([[false, false], [true, false], [false, true]]);
        assert_eq!(one.entry_point().unwrap(), Some("trace_greedily"));
        assert_eq!(one.rewrite(&module, Scalar::F32).unwrap().unwrap().1, "rewritten");
        let none = additions([[false, false]; 3]);
        assert_eq!(none.entry_point().unwrap(), None);
        assert!(none.rewrite(&module, Scalar::F32).unwrap().is_none());
        let two = additions([[true, false], [false, false], [true, false]]);
        assert!(matches!(two.entry_point(), Err(Error::Internal(_))));
        let two = additions([[false, true], [false, false], [false, true]]);
        assert!(matches!(two.rewrite(&module, Scalar::F32), Err(Error::Internal(_))));
    }
}
