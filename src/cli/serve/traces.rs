//! The traces that requests ask for, by the session's device and shaders.

use crate::cli::serve::requests::TraceRequest;
use crate::error::{Error, Result};
use crate::model::SceneIr;
use crate::result::TraceResult;
use crate::run::gradients::Differentiated;
use crate::run::{DerivativeOptions, LossDerivatives, Next, RecordPaths, Run, Session, Status};
use crate::scene::Scene;
use ndarray::ArrayD;
use std::time::Instant;

impl TraceRequest {
    /// Traces, with derivatives if the request names parameters. `next` gets the status after each pass, and says how to go
    /// on.
    pub(crate) fn trace(
        &self,
        session: &mut Session,
        mut next: impl FnMut(&Status) -> Next,
    ) -> Result<TraceResult> {
        self.args.refuse_guide_to("a session")?;
        if self.gradient.is_empty() {
            let start = Instant::now();
            let scene = Scene::with_numbers(&self.scene, &self.folder, &self.set);
            let scene = scene.map_err(|error| self.named(error))?;
            let run = Run::new(scene)?.change_model(|ir| self.args.override_sampling(ir))?;
            let run = self.photometric.set(run)?;
            let mut run = self.run(session, run)?.record_paths(self.record_paths);
            run.start = start;
            return Ok(run.go_with(|pass| Ok(next(&pass.status)))?.result);
        }
        self.refuse_options_of_one_trace("gradient")?;
        let scene = self.differentiated()?;
        let asked =
            DerivativeOptions { without_errors: !self.gradient_errors, with_edges: self.gradient_edges };
        self.run(session, scene.run())?.differentiate(&scene, asked, next)?.into_result()
    }

    /// Differentiates the loss that the request has adjoints of.
    pub(crate) fn loss_gradient(
        &self,
        session: &mut Session,
        adjoints: &[(String, ArrayD<f64>)],
        next: impl FnMut(&Status) -> Next,
    ) -> Result<LossDerivatives> {
        if self.gradient.is_empty() {
            return Err(Error::Usage(
                "a loss has adjoints and no parameters; name some in `gradient`".into(),
            ));
        }
        self.refuse_options_of_one_trace("adjoints")?;
        let scene = self.differentiated()?;
        let mut of_all: Vec<Vec<f64>> = scene.adjoint_lengths().map(|num| vec![0.0; num]).collect();
        for (name, adjoints) in adjoints {
            let known = scene.ir.detectors.iter().position(|detector| detector.name == *name);
            let known = known
                .ok_or_else(|| Error::Usage(format!("adjoints of `{name}`: no detector has this name")))?;
            of_all[known] = scene.adjoints_of(known, adjoints)?;
        }
        let run = self.run(session, scene.run())?;
        run.loss_gradient(&scene, &of_all, self.gradient_edges, self.check_edges, next)
    }

    /// The run on the session's device, with the request's options.
    fn run<'a>(&self, session: &'a mut Session, run: Run<'a>) -> Result<Run<'a>> {
        self.args.set(session.run(run, self.live)?)
    }

    /// The scene, and the parameters by which it is differentiated.
    fn differentiated(&self) -> Result<Differentiated> {
        let change = |ir: &mut SceneIr| self.args.override_sampling(ir);
        Differentiated::new(&self.scene, &self.folder, &self.set, &self.gradient, change)
            .map_err(|error| self.named(error))
    }

    fn named(&self, error: Error) -> Error {
        match &self.name {
            Some(name) => error.in_scene(name),
            None => error,
        }
    }

    /// Refuses options that derivatives cannot heed. `what` the request has beside them.
    fn refuse_options_of_one_trace(&self, what: &str) -> Result<()> {
        let records = (self.record_paths != RecordPaths::None).then_some("record-paths");
        let photometric = self.photometric.is_asked_for().then_some("photometric");
        match self.args.of_one_trace().or(records).or(photometric) {
            Some(name) => Err(Error::Usage(format!(
                "options.{} and {what} do not go together; give one of them up",
                name.replace('-', "_")
            ))),
            None => Ok(()),
        }
    }
}
