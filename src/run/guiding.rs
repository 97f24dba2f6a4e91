//! Guides the rays of a run: learns a guide by a pilot, or takes one that was learned before.

use crate::engine::pipeline_cache::{PipelineCache, Shaders};
use crate::error::{Error, Result};
use crate::gpu::Gpu;
use crate::guide::learn::{Wanted, learn};
use crate::guide::{self, Guide};
use crate::program::Sampler;
use crate::result::GuideInfo;
use crate::run::additions::ForAdapter;
use crate::run::go::Settled;
use crate::run::{Collect, Guiding, RecordPaths, Run, StandardError, TraceOptions, Tracer};
use crate::scene::GuidedLight;
use std::sync::Arc;

/// The seed of a pilot's round, which is not the seed of the trace.
fn seed_of_round(seed: u64, round: usize) -> u64 {
    // The increment of SplitMix64 (Steele et al., Fast splittable pseudorandom number generators, OOPSLA 2014).
    seed.wrapping_add(0x9E37_79B9_7F4A_7C15_u64.wrapping_mul(round as u64 + 1))
}

impl<'a> Run<'a> {
    /// Guides rays to rare light, such as the ghosts of coated lenses. A pilot with draws of its own learns how.
    #[must_use]
    pub fn guide(self, wanted: Wanted) -> Self {
        Run { guiding: Some(Guiding::Learned(wanted)), ..self }
    }

    /// Changes to which light rays are guided, where a pilot learns that.
    #[must_use]
    pub fn change_guide(mut self, change: impl FnOnce(&mut Wanted)) -> Self {
        if let Some(Guiding::Learned(wanted)) = &mut self.guiding {
            change(wanted);
        }
        self
    }

    /// Guides rays by what an earlier run has learned: the guide among the options of its [`crate::Outcome`].
    #[must_use]
    pub fn guide_by(self, guide: Arc<Guide>) -> Self {
        Run { guiding: Some(Guiding::Given(guide)), ..self }
    }

    /// The settings with their guide, if rays are guided. A trace that goes on is guided as it began.
    pub(crate) fn guided(&self, gpu: &Gpu, settled: Settled, begun: Option<&Guide>) -> Result<Settled> {
        let Settled { options, mut info } = settled;
        let of_scene =
            self.guiding.is_none().then(|| self.scene.guided_light(&self.model)).transpose()?.flatten();
        let of_scene = of_scene.map(|GuidedLight { detector, filter }| {
            Guiding::Learned(Wanted { detector, filter: filter.map(Arc::new), ..Wanted::default() })
        });
        let (guide, learned) = match (begun, self.guiding.as_ref().or(of_scene.as_ref())) {
            (None, None) => return Ok(Settled { options, info }),
            (Some(guide), _) => (Arc::new(guide.clone()), None),
            (None, Some(Guiding::Given(guide))) => (guide.clone(), None),
            (None, Some(Guiding::Learned(wanted))) => {
                guide::check(&self.model, &options)?;
                if options.first_ray > 0 || options.of_rays.is_some() {
                    return Err(Error::Usage(
                        "the parts of a trace share one guide: learn it by --guide --guide-to FILE, and give each part --guide-from FILE"
                            .into(),
                    ));
                }
                let learned = self.learn(gpu, &options, wanted)?;
                (Arc::new(learned.guide), Some((learned.num_rays, learned.num_rows)))
            }
        };
        info.guide = Some(GuideInfo {
            pilot_rays: learned.map(|(rays, _)| rays),
            num_rows: learned.map(|(_, rows)| rows),
            ..GuideInfo::of(&guide)
        });
        Ok(Settled { options: TraceOptions { guide: Some(guide), ..options }, info })
    }

    /// What a run traces with that takes no guide.
    pub(crate) fn settle_unguided(&self, gpu: &Gpu) -> Result<Settled> {
        match self.guiding {
            None => self.settle(gpu),
            Some(_) => Err(Error::Usage(
                "derivatives take rays that are not guided; leave out --guide and --guide-from".into(),
            )),
        }
    }

    fn learn(&self, gpu: &Gpu, options: &TraceOptions, wanted: &Wanted) -> Result<guide::learn::Learned> {
        // One shader serves all rounds.
        let own = PipelineCache::new();
        let shaders = Shaders { cache: Some(self.cache.unwrap_or(&own)), edit: None };
        learn(&self.model, wanted, options.num_rays, |guide, num_rays, round| {
            let options = TraceOptions {
                num_rays,
                seed: seed_of_round(options.seed, round),
                guide: Some(Arc::new(guide.clone())),
                collect: match options.collect {
                    Collect::Paths { .. } => options.collect.clone(),
                    _ => Collect::paths(),
                },
                paths: RecordPaths::None,
                sampler: Sampler::Pcg,
                standard_error: StandardError::Off,
                may_end_early: false,
                ..options.clone()
            };
            Tracer::with(gpu, &self.model, &options, ForAdapter::WhatPays, shaders)?.trace(|_| true)
        })
    }
}
