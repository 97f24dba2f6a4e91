//! Composition of the stages that follow paths: the hot path, and the side traces.

use crate::cpu::path::hot_path::{Crossing, HotPath, HotPathEvent};
use crate::cpu::path::miss_test::{Exit, MissTest, Sign};
use crate::cpu::path::path_log::{PathLog, Weight};
use crate::cpu::path::side_trace;
use crate::cpu::request::CpuShader;
use crate::error::{Error, Result};
use crate::model::shapes::Normal;
use crate::model::{Frame, Shape};
use crate::program::input::ProgramInput;
use crate::program::layout::tables;
use crate::program::wgsl::composition::Composition;
use crate::shaders::{ShaderFile, shader};
use std::fmt::Write;

/// Stands for the ray in a statement, behind the name of a variable that each ray has for itself.
const RAY: char = '@';
/// A ray that an invocation follows alone.
const ALONE: &str = "";
/// The two rays that an invocation follows side by side.
const PAIR: [&str; 2] = ["_a", "_b"];

/// What a stage does with each of its rays.
struct Walk {
    /// What the statements call.
    functions: String,
    /// One after the other, with [`RAY`].
    statements: Vec<String>,
}

impl Walk {
    /// The statements for a single ray.
    fn alone(&self) -> String {
        self.statements.iter().map(|statement| format!("    {}\n", of_ray(statement, ALONE))).collect()
    }

    /// The statements for two rays, by turns: what one ray waits for, the processor does for the other meanwhile.
    fn of_pair(&self) -> String {
        let by_turns = self.statements.iter().flat_map(|statement| PAIR.map(|ray| (ray, statement)));
        by_turns
            .map(|(ray, statement)| {
                format!("    take_up{ray}();\n    {}\n    put_by{ray}();\n", of_ray(statement, ray))
            })
            .collect()
    }
}

fn of_ray(statement: &str, ray: &str) -> String {
    statement.replace(RAY, ray)
}

/// A variable that is a ray's as long as an invocation follows it along a path.
struct State {
    name: &'static str,
    kind: &'static str,
    first: &'static str,
}

impl State {
    /// The variables that a file of shaders/ declares.
    fn declared_in(file: ShaderFile) -> impl Iterator<Item = State> {
        file.text.lines().filter_map(|line| {
            let (name, rest) = line.strip_prefix("var<private> ")?.split_once(": ")?;
            let (kind, first) = rest.strip_suffix(';')?.split_once(" = ")?;
            Some(State { name, kind, first })
        })
    }
}

/// The stages of the paths of a module.
pub(crate) struct Stages<'a> {
    pub(crate) extension: &'a CpuShader,
    pub(crate) composition: &'a Composition<'a>,
}

impl Stages<'_> {
    /// The text of all stages: first the hot path, then the side traces.
    pub(crate) fn text(&self) -> Result<String> {
        let extension = self.extension;
        let Some(hot_path) = &extension.hot_path else { return Ok(String::new()) };
        let walk = self.walk(0, hot_path, extension.path_log.as_ref())?;
        let mut text = match extension.has_pairs {
            true => self.states_of_pair() + &self.stage_of_pair(&walk),
            false => self.path_stage(0, "trace_hot_path", &walk),
        };
        for (number, side) in extension.side_traces.iter().enumerate() {
            let walk = self.walk(1 + number, &side.path, side.log.as_ref())?;
            text.push_str(&self.path_stage(1 + number, &side_trace::entry_point(number), &walk));
        }
        Ok(text)
    }

    /// The stage of a path: for rays of the range or, on a side trace, for rays of a list.
    fn path_stage(&self, number: usize, entry_point: &str, walk: &Walk) -> String {
        let key = if number == 0 { "key_in_range" } else { "key_of" };
        let follow = match self.extension.rays_per_invocation {
            1 => format!("    follow_{number}(invocation);\n"),
            _ => format!(
                "    var turn = 0u;\n    var next = first_turn(invocation);\n    loop {{\n        follow_{number}(next);\n        \
                 next = next_turn(next);\n        turn += 1u;\n        \
                 if turn >= PATH_RAYS_PER_INVOCATION {{\n            break;\n        }}\n    }}\n"
            ),
        };
        format!(
            "{}fn follow_{number}(index: u32) {{\n    if index >= range.count {{\n        return;\n    }}\n    \
             begin_ray();\n    var ray = new_ray({key}(index), index);\n{}}}\n{}",
            walk.functions,
            walk.alone(),
            entry(entry_point, &follow)
        )
    }

    /// The stage of the hot path, of whose rays each invocation follows two.
    fn stage_of_pair(&self, walk: &Walk) -> String {
        let [a, b] = PAIR;
        let births: String = PAIR
            .map(|ray| format!("    var ray{ray} = new_ray(key_in_range(index{ray}), index{ray});\n"))
            .concat();
        format!(
            "{}fn follow_pair(invocation: u32) {{\n    let index{a} = first_of_pair(invocation);\n    \
             if index{a} >= range.count {{\n        return;\n    }}\n    \
             let index{b} = second_of_pair(invocation, index{a});\n    begin_ray();\n{births}{}}}\n{}",
            walk.functions,
            walk.of_pair(),
            entry("trace_hot_path", "    follow_pair(invocation);\n")
        )
    }

    /// The variables that each ray of a pair has for itself, and what brings them to where the functions of the path look.
    fn states_of_pair(&self) -> String {
        let mut files = vec![shader!("cpu/path/hot_path.wgsl"), shader!("cpu/path/path_log.arrivals.wgsl")];
        if self.extension.logs_weights() {
            files.push(shader!("cpu/path/path_losses.reported.wgsl"));
        }
        let states: Vec<State> = files.into_iter().flat_map(State::declared_in).collect();
        let mut text = String::new();
        for ray in PAIR {
            for State { name, kind, first } in &states {
                let _ = writeln!(text, "var<private> {name}{ray}: {kind} = {first};");
            }
            let take_up = states.iter().map(|State { name, .. }| format!("    {name} = {name}{ray};\n"));
            let put_by = states.iter().map(|State { name, .. }| format!("    {name}{ray} = {name};\n"));
            let _ = write!(
                text,
                "fn take_up{ray}() {{\n{}}}\nfn put_by{ray}() {{\n{}}}\n",
                take_up.collect::<String>(),
                put_by.collect::<String>()
            );
        }
        text
    }

    /// A path. Each event finds the nearest of the primitives that can be met before the path's next one. A guard
    /// checks that the ray misses the primitives that are not searched.
    fn walk(&self, number: usize, path: &HotPath, path_log: Option<&PathLog>) -> Result<Walk> {
        let mut functions = String::new();
        let mut statements = vec!["var holds@ = true;".to_string()];
        let mut last = None;
        for (step, event) in path.events.iter().enumerate() {
            let candidates = event.candidates.iter().map(|&i| (i, (last == Some(i)).to_string()));
            let head = format!("nearest_at_{number}_{step}(ray: Ray)");
            let nearer = event.at_nearer_crossing.then_some(event.primitive);
            functions.push_str(&self.composition.nearest_of(&head, "Hit(MISS, NONE)", nearer, candidates)?);
            let head = format!("misses_at_{number}_{step}(ray: Ray, distance: real)");
            functions.push_str(&self.misses_all(&head, &event.passed)?);
            statements.push(format!("let hit_{step}@ = nearest_at_{number}_{step}(ray@);"));
            statements.push(holds(&format!("misses_at_{number}_{step}(ray@, hit_{step}@.distance)")));
            statements.extend(match event.primitive < self.composition.ir.surfaces.len() {
                true => vec![self.meeting(step, event)?],
                false => self.arrival(step, event, path_log)?,
            });
            statements.push("kept_events += select(0u, 1u, holds@);".to_string());
            last = Some(event.primitive);
        }
        if let Some(missed) = &path.missed {
            let candidates = missed.candidates.iter().map(|&i| (i, (last == Some(i)).to_string()));
            let head = format!("nearest_behind_{number}(ray: Ray)");
            functions.push_str(&self.composition.nearest_of(&head, "Hit(MISS, NONE)", None, candidates)?);
            let head = format!("misses_behind_{number}(ray: Ray)");
            functions.push_str(&self.misses_all(&head, &missed.passed)?);
            statements.push(holds(&format!("(nearest_behind_{number}(ray@).primitive == NONE)")));
            statements.push(holds(&format!("misses_behind_{number}(ray@)")));
            statements.push("ray@.fate = ESCAPED;".to_string());
        }
        if let Some(log) = path_log {
            statements.extend(self.log_end(log)?);
        }
        statements.push("end_path(ray@, holds@ & has_position(ray@));".to_string());
        Ok(Walk { functions, statements })
    }

    /// What is left to log, and to look at, where the path ends.
    fn log_end(&self, log: &PathLog) -> Result<Vec<String>> {
        let mut statements = match log.end {
            Some(end) => self.weighs(end.weight)?,
            None => Vec::new(),
        };
        if log.places.is_empty() {
            statements.push("keep_arrival(0u, ray@, vec2<real>(0.0, 0.0));".to_string());
        }
        statements.extend(log.attenuating_legs.map(|legs| holds(&format!("are_losses_reported({legs}u)"))));
        Ok(statements)
    }

    /// An event of the path on a surface.
    fn meeting(&self, step: usize, event: &HotPathEvent) -> Result<String> {
        let primitive = event.primitive;
        let scene: &ProgramInput = self.composition;
        let surfaces = tables::surface_records(scene.ir, scene.centre, &scene.features, &scene.places);
        let surface = surfaces.row(&self.composition.numbers, primitive)?;
        let (does, how) = match event.crossing {
            Some(Crossing { entering_back, reflected }) => {
                ("crosses", format!(", {entering_back}, {reflected}"))
            }
            None if event.ends => ("ends_on_surface", String::new()),
            None => ("keeps_to", String::new()),
        };
        Ok(holds(&format!("{does}(&ray@, hit_{step}@, {surface}, {primitive}u{how})")))
    }

    /// An event of the path on a detector.
    fn arrival(&self, step: usize, event: &HotPathEvent, path_log: Option<&PathLog>) -> Result<Vec<String>> {
        let HotPathEvent { primitive, ends, .. } = *event;
        let Some(log) = path_log else {
            let does = if ends { "ends_on_detector" } else { "passes" };
            return Ok(vec![holds(&format!("{does}(&ray@, hit_{step}@, {primitive}u)"))]);
        };
        let no_place = || Error::Internal(format!("event {step} of the path has no place in its log"));
        let (number, place, arrival) = log.arrival(step).ok_or_else(no_place)?;
        let mut statements = vec![holds(&format!("arrives(&ray@, hit_{step}@, {primitive}u)"))];
        if place.arrivals[0].event == step {
            let logs = match place.edge_room {
                None => format!("log_arrival({number}u, ray@, {}u)", place.detector),
                Some([x, y]) => {
                    let [x, y] = [self.real(x)?, self.real(y)?];
                    format!(
                        "log_arrival_off_edges({number}u, ray@, {}u, vec2<real>({x}, {y}))",
                        place.detector
                    )
                }
            };
            statements.push(format!("let arrival_{number}@ = {logs};"));
            statements.push(holds(&format!("arrival_{number}@.is_sure")));
        } else {
            let again = format!("arrival_on(ray@, {}u)", place.detector);
            statements.push(holds(&format!("all({again} == arrival_{number}@.at)")));
        }
        statements.extend(self.weighs(arrival.weight)?);
        if !ends {
            statements.push(holds("goes_on(&ray@)"));
        }
        Ok(statements)
    }

    /// Looks whether a ray of the path weighs what the host takes it to.
    fn weighs(&self, weight: Weight) -> Result<Vec<String>> {
        Ok(match weight {
            Weight::Born | Weight::Logged => Vec::new(),
            Weight::Known(weight) => vec![holds(&format!("(ray@.weight == {})", self.real(weight)?))],
        })
    }

    /// A function that is true if a ray misses all that is passed until it has gone `distance`.
    fn misses_all(&self, head: &str, passed: &[(usize, MissTest)]) -> Result<String> {
        let primitives = crate::model::primitives::primitives(self.composition.ir);
        let mut text = format!("fn {head} -> bool {{\n    var misses = true;\n");
        for &(i, miss_test) in passed {
            let _ = writeln!(text, "    misses = misses & {};", self.misses(&primitives[i], miss_test)?);
        }
        text.push_str("    return misses;\n}\n");
        Ok(text)
    }

    /// A call that is true if the ray misses one of them.
    fn misses(&self, (frame, shape): &(Frame, Shape), miss_test: MissTest) -> Result<String> {
        let (o, d) = self.composition.in_frame(frame)?;
        let (keeps_pace, distance) = match miss_test.exit {
            None => (String::new(), "distance".to_string()),
            Some(Exit { plane, pace }) => {
                let [plane, pace] = [self.real(plane)?, self.real(pace)?];
                (format!("keeps_pace({d}, {pace}) & "), format!("exit_distance({o}, {plane}, {pace})"))
            }
        };
        let sign = match miss_test.sign {
            Sign::Leaves => format!("leaves({o}, {d}, {}, {distance})", self.quadric(shape)?),
            Sign::Beside { low, high } => {
                let [low, high] = [self.real(low)?, self.real(high)?];
                format!("stays_beside({o}, {d}, {low}, {high}, {distance})")
            }
            Sign::Past => format!("is_past({distance})"),
            Sign::Inside { limit } => format!("stays_inside({o}, {d}, {}, {distance})", self.real(limit)?),
            Sign::Off { margin } => {
                let (quadric, margin) = (self.quadric(shape)?, self.real(margin)?);
                format!("stays_off({o}, {d}, {quadric}, {margin}, {distance})")
            }
        };
        Ok(keeps_pace + &sign)
    }

    fn real(&self, value: f64) -> Result<String> {
        self.composition.real(value)
    }

    /// A call that gives a shape's quadric, as its search has it.
    fn quadric(&self, shape: &Shape) -> Result<String> {
        let no_quadric = || Error::Internal(format!("{shape:?} has no quadric to be clear of"));
        let Normal::Quadric(quadric) = shape.kind().wgsl().normal else { return Err(no_quadric()) };
        let arguments = shape.arguments().into_iter().map(|argument| self.real(argument));
        let arguments = arguments.collect::<Result<Vec<_>>>()?;
        Ok(quadric(&arguments.iter().map(String::as_str).collect::<Vec<_>>()))
    }
}

/// The ray keeps to the path if this holds, too.
fn holds(condition: &str) -> String {
    format!("holds@ = {condition} & holds@;")
}

/// The entry point of a stage.
fn entry(name: &str, follow: &str) -> String {
    format!(
        "@compute @workgroup_size(WORKGROUP_SIZE)\n\
         fn {name}(invoked: Invocation) {{\n    let invocation = begin_stage(invoked);\n{follow}    end_stage();\n}}\n"
    )
}
