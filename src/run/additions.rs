//! Which additions a trace has: those that its options ask for, and what pays on its adapter.
//!
//! This is the one place that chooses the additions of a trace. A trace beside the main one has a list of its own, such
//! as `FollowedPaths::additions`. [`COMPOSITIONS`] says which additions trace together.

#[cfg(feature = "cpu")]
use crate::cpu::{Cpu, CpuOverrides};
use crate::derivatives::Derivatives;
use crate::engine::addition::{Addition, Additions};
use crate::engine::options::{Collect, TraceOptions};
use crate::gpu::Gpu;
use crate::guide::Guided;
use crate::paths::followed::FollowedPaths;
use crate::paths::totals::PathTotals;

/// How two additions trace together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Together {
    /// Both are in one trace.
    Yes,
    /// [`Collect`] has one of them at a time: options cannot ask for both.
    OneAtATime,
    /// The second stands aside, which changes no bit of a result.
    StandsAside,
    /// Options that ask for both are refused by name.
    Refused,
}

/// What may be added to a trace.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A table of light by its path.
    PathTable,
    /// A filter of light by its path.
    PathFilter,
    /// Maps of paths, from a second trace.
    PathMaps,
    /// What happens to each ray, from a second trace.
    PathEvents,
    /// Rays are guided to rare light. A guided trace also follows paths, because a ray's node in the guide is a word of
    /// the ray's path.
    Guide,
    /// Derivatives in forward mode.
    Tangents,
    /// Derivatives in reverse mode.
    Adjoints,
    /// What pays on processors.
    Cpu,
}

/// Which additions trace together. A pair stands in the order of [`Kind`].
pub const COMPOSITIONS: &[(Kind, Kind, Together)] = &[
    (Kind::PathTable, Kind::PathFilter, Together::Yes),
    (Kind::PathTable, Kind::PathMaps, Together::OneAtATime),
    (Kind::PathTable, Kind::PathEvents, Together::OneAtATime),
    (Kind::PathTable, Kind::Guide, Together::Yes),
    (Kind::PathTable, Kind::Tangents, Together::OneAtATime),
    (Kind::PathTable, Kind::Adjoints, Together::OneAtATime),
    (Kind::PathTable, Kind::Cpu, Together::Yes),
    (Kind::PathFilter, Kind::PathMaps, Together::Yes),
    (Kind::PathFilter, Kind::PathEvents, Together::Yes),
    (Kind::PathFilter, Kind::Guide, Together::Yes),
    (Kind::PathFilter, Kind::Tangents, Together::Yes),
    (Kind::PathFilter, Kind::Adjoints, Together::Yes),
    (Kind::PathFilter, Kind::Cpu, Together::Yes),
    (Kind::PathMaps, Kind::PathEvents, Together::OneAtATime),
    (Kind::PathMaps, Kind::Guide, Together::Yes),
    (Kind::PathMaps, Kind::Tangents, Together::OneAtATime),
    (Kind::PathMaps, Kind::Adjoints, Together::OneAtATime),
    (Kind::PathMaps, Kind::Cpu, Together::StandsAside),
    (Kind::PathEvents, Kind::Guide, Together::Yes),
    (Kind::PathEvents, Kind::Tangents, Together::OneAtATime),
    (Kind::PathEvents, Kind::Adjoints, Together::OneAtATime),
    (Kind::PathEvents, Kind::Cpu, Together::StandsAside),
    (Kind::Guide, Kind::Tangents, Together::Refused),
    (Kind::Guide, Kind::Adjoints, Together::Refused),
    (Kind::Guide, Kind::Cpu, Together::Yes),
    (Kind::Tangents, Kind::Adjoints, Together::OneAtATime),
    (Kind::Tangents, Kind::Cpu, Together::StandsAside),
    (Kind::Adjoints, Kind::Cpu, Together::StandsAside),
];

/// What options ask for.
fn kinds(options: &TraceOptions) -> Vec<Kind> {
    let collected = match options.collect {
        Collect::Light => None,
        Collect::Paths { .. } => Some(Kind::PathTable),
        Collect::PathMaps(_) => Some(Kind::PathMaps),
        Collect::Events { .. } => Some(Kind::PathEvents),
        Collect::Tangents(_) => Some(Kind::Tangents),
        Collect::Adjoints => Some(Kind::Adjoints),
    };
    let filter = options.path_filter.as_ref().map(|_| Kind::PathFilter);
    let guide = options.guide.as_ref().map(|_| Kind::Guide);
    collected.into_iter().chain(filter).chain(guide).collect()
}

/// How what pays on processors traces together with what is asked for.
#[cfg(feature = "cpu")]
fn stands_aside(asked: Kind) -> bool {
    COMPOSITIONS.contains(&(asked, Kind::Cpu, Together::StandsAside))
}

/// The additions that options ask for.
fn of_options(options: &TraceOptions) -> Additions {
    let paths = FollowedPaths::of(options).map(|followed| match options.collect {
        Collect::Paths { rows, .. } => Box::new(PathTotals::new(followed, rows)) as Box<dyn Addition>,
        _ => Box::new(followed),
    });
    let derivatives = Derivatives::of(options).map(|derivatives| Box::new(derivatives) as Box<dyn Addition>);
    let guided = Guided::of(options).map(|guided| Box::new(guided) as Box<dyn Addition>);
    Additions::new(paths.into_iter().chain(guided).chain(derivatives).collect())
}

/// What a trace has beside what its options ask for.
#[derive(Debug, Clone, Copy, Default)]
pub enum ForAdapter<'c> {
    /// What pays on the adapter.
    #[default]
    WhatPays,
    /// Nothing: for measurements.
    Nothing,
    /// What these overrides say, even where that does not pay: for tests.
    #[cfg(feature = "cpu")]
    Forced(&'c CpuOverrides),
    /// Never there: it holds the lifetime where there is nothing to force.
    #[cfg(not(feature = "cpu"))]
    #[doc(hidden)]
    Never(std::marker::PhantomData<&'c ()>, std::convert::Infallible),
}

/// The additions that options ask for, and those for the adapter.
#[cfg(feature = "cpu")]
pub(crate) fn of(gpu: &Gpu, options: &TraceOptions, for_adapter: ForAdapter) -> Additions {
    let asked = of_options(options);
    let cpu = match for_adapter {
        ForAdapter::WhatPays => Cpu::for_adapter(gpu, options, &CpuOverrides::default()),
        ForAdapter::Nothing => None,
        ForAdapter::Forced(overrides) => Cpu::for_adapter(gpu, options, overrides),
    };
    match cpu {
        Some(cpu) if !kinds(options).into_iter().any(stands_aside) => asked.and(cpu),
        _ => asked,
    }
}

/// The additions that options ask for.
#[cfg(not(feature = "cpu"))]
pub(crate) fn of(_gpu: &Gpu, options: &TraceOptions, _for_adapter: ForAdapter) -> Additions {
    of_options(options)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::guide;
    use crate::model::guide::{Guide, PLAIN};
    use crate::model::{PathFilter, SceneIr};
    use crate::program::rewrite::jvp::Tangents;
    use crate::scene::Scene;
    use std::sync::Arc;

    const ALL: [Kind; 8] = [
        Kind::PathTable,
        Kind::PathFilter,
        Kind::PathMaps,
        Kind::PathEvents,
        Kind::Guide,
        Kind::Tangents,
        Kind::Adjoints,
        Kind::Cpu,
    ];

    fn example() -> SceneIr {
        let example = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/example.json");
        Scene::from_path(example.as_ref()).unwrap().lower().unwrap()
    }

    /// Asks for an addition.
    fn ask(kind: Kind, options: &mut TraceOptions) {
        match kind {
            Kind::PathTable => options.collect = Collect::paths(),
            Kind::PathMaps => options.collect = Collect::PathMaps(1),
            Kind::PathEvents => options.collect = Collect::Events { ends: false },
            Kind::Tangents => options.collect = Collect::Tangents(Arc::new(Tangents { parameters: vec![] })),
            Kind::Adjoints => options.collect = Collect::Adjoints,
            Kind::PathFilter => {
                options.path_filter = Some(Arc::new(PathFilter::parse("source(beam)", &example()).unwrap()));
            }
            Kind::Guide => options.guide = Some(Arc::new(Guide::new(&example(), [PLAIN, PLAIN]))),
            // Nobody asks for what pays.
            Kind::Cpu => {}
        }
    }

    #[test]
    fn the_table_has_every_pair_once() {
        let pairs: Vec<(Kind, Kind)> = COMPOSITIONS.iter().map(|&(one, two, _)| (one, two)).collect();
        let every = ALL.iter().enumerate().flat_map(|(i, one)| ALL[i + 1..].iter().map(|two| (*one, *two)));
        assert_eq!(pairs, every.collect::<Vec<_>>());
    }

    #[test]
    fn options_hold_the_pairs_that_the_table_has_together() {
        for &(one, two, together) in COMPOSITIONS.iter().filter(|(_, two, _)| *two != Kind::Cpu) {
            let mut options = TraceOptions::default();
            ask(one, &mut options);
            ask(two, &mut options);
            let asked = kinds(&options);
            let both = asked.contains(&one) && asked.contains(&two);
            let is_refused = guide::check(&example(), &options).is_err();
            let expected =
                [matches!(together, Together::Yes | Together::Refused), together == Together::Refused];
            let is_asked = both && options.guide.is_some();
            assert_eq!([both, is_asked && is_refused], expected, "{one:?} and {two:?}: {asked:?}");
        }
    }

    #[cfg(feature = "cpu")]
    #[test]
    fn what_pays_on_processors_stands_aside_where_the_table_says_so() {
        use crate::cpu::Override;
        use crate::gpu::AdapterChoice;
        if crate::gpu::list_adapters().is_empty() {
            return;
        }
        let gpu = Gpu::open(&AdapterChoice::default()).unwrap();
        let forced = CpuOverrides { side_by_side: Override::Always, ..CpuOverrides::default() };
        for &(one, _, together) in COMPOSITIONS.iter().filter(|(_, two, _)| *two == Kind::Cpu) {
            let mut options = TraceOptions::default();
            ask(one, &mut options);
            let has_cpu = of(&gpu, &options, ForAdapter::Forced(&forced)).get::<Cpu>().is_some();
            assert_eq!(has_cpu, together == Together::Yes, "{one:?}");
        }
    }
}
