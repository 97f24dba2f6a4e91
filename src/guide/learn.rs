//! Learns a guide from tables of paths, so that the first rows of a table get equal relative errors.
//!
//! A row that plain rays bring too seldom is to be drawn on purpose, by the sequences of its light. How often each
//! sequence is to be drawn follows from how many of its rays arrive. Probabilities at faces then follow from the tree
//! of all sequences. Of the sequences that have come as the ray has, some reflect next: the ray reflects with their
//! share. Some scatter next, and the ray scatters with their share.

use crate::error::Result;
use crate::model::bsdfs::Scatter;
use crate::model::guide::{Choice, Guide, NO_NODE, PLAIN, PLAIN_SHARE, fits};
use crate::model::sequence::{End, Sequence, Step, StepKind};
use crate::model::{Interaction, PathFilter, SceneIr};
use crate::result::light_paths::{Group, groups};
use crate::result::{FluxUnit, Grouping, PathSum, PathTally, QUANTA_PER_WEIGHT, Recoating, Tally};
use std::collections::BTreeMap;
use std::sync::Arc;

/// To which light rays are guided.
#[derive(Debug, Clone)]
pub struct Wanted {
    /// The detector of that light, by its number; all if none.
    pub detector: Option<usize>,
    /// Light of these paths alone.
    pub filter: Option<Arc<PathFilter>>,
    /// What a row is.
    pub group: Grouping,
    /// So many rows, the ones of most flux, are to have equal relative errors.
    pub top: usize,
}

impl Default for Wanted {
    fn default() -> Self {
        Wanted { detector: None, filter: None, group: Grouping::Sequence, top: DEFAULT_ROWS }
    }
}

/// Rows to which rays are guided, unless others were asked for.
pub const DEFAULT_ROWS: usize = 20;

/// What a pilot learned.
#[derive(Debug, Clone)]
pub struct Learned {
    /// The guide.
    pub guide: Guide,
    /// Rays of the pilot.
    pub num_rays: u64,
    /// Rows to which it guides.
    pub num_rows: usize,
}

/// A pilot's rounds: its rays, as a share of the largest number, and how many of them explore.
const ROUNDS: [(f64, f64); 3] = [(0.25, 1.0), (1.0, 0.5), (1.0, 0.15)];
/// Rays of a pilot's largest round, as a share of the trace's.
const SHARE_OF_TRACE: f64 = 0.125;
/// Fewest and most rays of a pilot's largest round.
const FEWEST_RAYS: u64 = 1 << 15;
const MOST_RAYS: u64 = 1 << 17;
/// Reflections and scatterings up to which exploring rays turn on purpose.
pub(super) const MOST_EXPLORED: usize = 4;
/// Choices that an exploring ray is taken to have on its way, before a pilot has counted them.
const CHOICES_AT_FIRST: usize = 12;
/// Most sequences that a guide follows.
const MOST_TARGETS: usize = 1 << 12;
/// The share of guided rays for rows beyond the first. Without this share a ray would come to such a row by chance
/// alone, and weigh as much as its path is rare.
const SHARE_OF_OTHERS: f64 = 0.2;
/// Rows of so much of the flux of the last of the first rows are taken to be among them.
const NEARLY_FIRST: f64 = 0.8;
/// The least mean square of weights that sums of squares hold to a hundredth.
const LEAST_SQUARE: f64 = 128.0 / QUANTA_PER_WEIGHT;
/// The least share of rays on a sequence that is taken to arrive.
const LEAST_ARRIVING: f64 = 1e-3;

/// Learns a guide for a trace of so many rays. `pilot` traces rays with a guide, by a seed of its own for each round, into a
/// table of paths.
///
/// # Errors
/// The errors of `pilot`.
pub fn learn(
    ir: &SceneIr,
    wanted: &Wanted,
    num_rays: u64,
    mut pilot: impl FnMut(&Guide, u64, usize) -> Result<Tally>,
) -> Result<Learned> {
    let most = ((num_rays as f64 * SHARE_OF_TRACE) as u64).clamp(FEWEST_RAYS, MOST_RAYS);
    let num_choices: usize = (0..ir.surfaces.len() as u32).map(|surface| choices(ir, surface)).sum();
    let mut turn = 1.0 / (num_choices.min(CHOICES_AT_FIRST) as f64 + 1.0);
    let mut tree = Tree::new(ir);
    let (mut learned, mut num_rows, mut known) = (0, 0, BTreeMap::new());
    for (round, (share, exploring)) in ROUNDS.into_iter().enumerate() {
        let guide = tree.guide(ir, Some(Exploring { share: exploring, turn }));
        let tally = pilot(&guide, (most as f64 * share) as u64, round)?;
        learned += tally.launched.count;
        let Some(sums) = &tally.path_sums else { continue };
        turn = choices_on_the_way(ir, sums).map_or(turn, |choices| 1.0 / (choices + 1.0));
        let piloted = Piloted { ir, tally: &tally, guide: &guide };
        sums.rows.iter().filter(|row| wanted.has(row.0)).for_each(|row| piloted.note(row, &mut known));
        let rows = rows(ir, &tally, sums, wanted.group, &known);
        if !rows.is_empty() {
            num_rows = num_first(&rows, wanted.top.max(1));
            tree = Tree::of(ir, &targets(rows, num_rows));
        }
    }
    // Where the pilot found nothing, exploring rays may still find something.
    let guide = match tree.num_targets {
        0 => tree.guide(ir, Some(Exploring { share: 1.0, turn })),
        _ => tree.guide(ir, None),
    };
    Ok(Learned { guide, num_rays: learned, num_rows })
}

/// How many choices a ray has that does not turn, on average of those that have some. `None` if there is no such ray.
fn choices_on_the_way(ir: &SceneIr, sums: &PathTally) -> Option<f64> {
    let straight =
        sums.rows.iter().filter(|(sequence, _)| sequence.reflections() + sequence.scatterings() == 0);
    let (count, num_choices) = straight.fold((0, 0), |(count, num_choices), (sequence, sum)| {
        let of_ray: usize = sequence.steps.iter().map(|step| choices(ir, step.surface)).sum();
        let num_rays = if of_ray > 0 { sum.count } else { 0 };
        (count + num_rays, num_choices + num_rays * of_ray as u64)
    });
    (count > 0).then(|| num_choices as f64 / count as f64)
}

/// How many choices a ray has at a surface: whether to reflect, and whether to scatter.
fn choices(ir: &SceneIr, surface: u32) -> usize {
    usize::from(refracts(ir, surface)) + usize::from(scatters(ir, surface))
}

fn refracts(ir: &SceneIr, surface: u32) -> bool {
    ir.surfaces[surface as usize].interaction == Interaction::Refractive
}

/// True if a surface scatters a part of its light, and not all of it.
fn scatters(ir: &SceneIr, surface: u32) -> bool {
    ir.surfaces[surface as usize].scatter.as_ref().is_some_and(Scatter::is_of_a_part)
}

impl Wanted {
    /// True if light of this sequence is wanted.
    fn has(&self, sequence: &Sequence) -> bool {
        let detector = sequence.end.detector();
        detector.is_some()
            && (self.detector.is_none() || self.detector == detector)
            && self.filter.as_ref().is_none_or(|filter| filter.keeps(sequence))
    }
}

/// A sequence, as the round of a pilot measured it that had most of its light.
#[derive(Debug, Clone, Copy)]
struct Measured {
    /// Rays of equal weight that would have the same relative error.
    effective: f64,
    /// Its light, as a share of all that was launched.
    flux: f64,
    /// The share of the rays that try to take the sequence, and arrive.
    arriving: f64,
}

/// The rows of all that is known, by falling flux: sequences, and what is known of each.
fn rows<'k>(
    ir: &SceneIr,
    tally: &Tally,
    sums: &PathTally,
    group: Grouping,
    known: &'k BTreeMap<Sequence, Measured>,
) -> Vec<Vec<(&'k Sequence, Measured)>> {
    let quanta = |measured: &Measured| (measured.flux * tally.launched.quanta as f64) as u128;
    let sum = |measured| PathSum { count: 1, quanta: quanta(measured), squares: 0 };
    let all = known.iter().map(|(sequence, measured)| (sequence.clone(), sum(measured))).collect();
    let all = PathTally { rows: all, ..sums.clone() };
    let unit = FluxUnit::of_scene(ir, tally.launched.count);
    let groups = groups(ir, tally, &all, unit, group, false, &Recoating::default());
    let members = |group: &Group| {
        group
            .sequences
            .iter()
            .filter_map(|&sequence| known.get_key_value(sequence))
            .map(|(sequence, m)| (sequence, *m))
            .collect()
    };
    groups.iter().filter(|group| group.row.flux > 0.0).map(members).collect()
}

/// The first rows, and those that may be among them: a pilot knows fluxes only roughly.
fn num_first(rows: &[Vec<(&Sequence, Measured)>], top: usize) -> usize {
    let flux = |row: &Vec<(&Sequence, Measured)>| row.iter().map(|(_, measured)| measured.flux).sum::<f64>();
    let last = rows.get(top - 1).map_or(0.0, flux);
    rows.iter().take_while(|row| flux(row) >= NEARLY_FIRST * last).count()
}

/// What a round of a pilot traced, and what guided it.
struct Piloted<'a> {
    ir: &'a SceneIr,
    tally: &'a Tally,
    guide: &'a Guide,
}

impl Piloted<'_> {
    /// Keeps what is known of a sequence, if no other round knows more.
    fn note(&self, (sequence, sum): (&Sequence, &PathSum), known: &mut BTreeMap<Sequence, Measured>) {
        let measured = self.measured(sequence, sum);
        if known.get(sequence).is_none_or(|before| before.effective < measured.effective) {
            known.insert(sequence.clone(), measured);
        }
    }

    fn measured(&self, sequence: &Sequence, sum: &PathSum) -> Measured {
        let num_rays = self.tally.launched.count.max(1) as f64;
        let [weight, squares] = [sum.quanta, sum.squares].map(|quanta| quanta as f64 / QUANTA_PER_WEIGHT);
        // Squares of tiny weights are rounded up to a quantum.
        let is_rounded = squares < LEAST_SQUARE * sum.count as f64;
        let effective = if is_rounded { sum.count as f64 } else { weight * weight / squares };
        let flux = sum.quanta as f64 / self.tally.launched.quanta.max(1) as f64;
        let tried = (1.0 - PLAIN_SHARE) * likelihood(self.guide, self.ir, sequence);
        // Of few rays not all can have come by plain chance.
        let guided = (effective / num_rays - PLAIN_SHARE * flux).max(0.1 * effective / num_rays);
        let arriving = if tried > 0.0 { (guided / tried).clamp(LEAST_ARRIVING, 1.0) } else { 1.0 };
        Measured { effective, flux, arriving }
    }
}

/// A sequence that rays are to take, and how many of the guided rays are to try.
struct Target<'a> {
    sequence: &'a Sequence,
    share: f64,
}

/// A row: in units of its effective rays, the guided rays that it needs, and what it gets from plain rays.
struct Row<'a> {
    members: Vec<(&'a Sequence, Measured)>,
    /// The sum of flux / sqrt(arriving).
    spread: f64,
    /// In proportion to this number it gets effective rays.
    aim: f64,
    cost: f64,
    plain: f64,
}

/// How often each sequence of some rows is to be tried: first the sequences of the first rows, then the others.
fn targets<'a>(mut rows: Vec<Vec<(&'a Sequence, Measured)>>, num_first: usize) -> Vec<Target<'a>> {
    let others = rows.split_off(num_first);
    let of_others = if others.is_empty() { 0.0 } else { SHARE_OF_OTHERS };
    let mut targets = shared(rows, 1.0 - of_others, Sharing::EqualErrors);
    targets.extend(shared(others, of_others, Sharing::ByFlux));
    targets.sort_by(|one, other| other.share.total_cmp(&one.share).then(one.sequence.cmp(other.sequence)));
    targets.truncate(MOST_TARGETS);
    targets
}

/// How many effective rays the rows of a share get.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Sharing {
    /// All as many: their relative errors are equal.
    EqualErrors,
    /// In proportion to their flux: a row that is nearly one of the first gets more than one that is far from them.
    ByFlux,
}

/// Shares guided rays among rows, which come by falling flux.
///
/// A row of sequences with fluxes F, of which shares s arrive, has the smallest variance if sequences are tried in
/// proportion to F / sqrt(s). The rays that it needs for an effective ray are then (sum of F / sqrt(s))^2 / (sum of F)^2.
fn shared(rows: Vec<Vec<(&Sequence, Measured)>>, of_guided: f64, aim: Sharing) -> Vec<Target<'_>> {
    let tried = |measured: &Measured| measured.flux / measured.arriving.sqrt();
    let rows: Vec<Row> = rows
        .into_iter()
        .map(|members| {
            let flux: f64 = members.iter().map(|(_, measured)| measured.flux).sum();
            let spread: f64 = members.iter().map(|(_, measured)| tried(measured)).sum();
            Row {
                members,
                spread,
                aim: if aim == Sharing::ByFlux { flux } else { 1.0 },
                cost: (spread / flux).powi(2) / (1.0 - PLAIN_SHARE),
                plain: PLAIN_SHARE * flux,
            }
        })
        .collect();
    let level = level(&rows, of_guided);
    let targets = rows.iter().flat_map(|Row { members, spread, aim, cost, plain }| {
        let share = (level * aim - plain).max(0.0) * cost / spread;
        members.iter().map(move |(sequence, measured)| Target { sequence, share: share * tried(measured) })
    });
    targets.filter(|target| target.share > 0.0).collect()
}

/// The effective share of rays that all rows reach with this share of the guided ones, in units of their aims.
fn level(rows: &[Row], of_guided: f64) -> f64 {
    let of_row = |level: f64, row: &Row| (level * row.aim - row.plain).max(0.0) * row.cost;
    let needed = |level: f64| rows.iter().map(|row| of_row(level, row)).sum::<f64>();
    let (mut low, mut high) = (0.0, 1e30);
    for _ in 0..256 {
        let middle = 0.5 * (low + high);
        if needed(middle) < of_guided { low = middle } else { high = middle }
    }
    high
}

/// How often the guided rays are to try each target: with no scattering behind them, with one, and so on.
///
/// To which side a ray scatters, and what the ray meets next, is chance. So one try is a try for all targets that go on
/// otherwise after the same scattering. The target that wants most tries says how many there are.
fn tries(targets: &[Target]) -> Vec<Vec<f64>> {
    let mut tries: Vec<Vec<f64>> =
        targets.iter().map(|target| vec![target.share; target.sequence.scatterings() + 1]).collect();
    let most = tries.iter().map(Vec::len).max().unwrap_or(1) - 1;
    for number in (0..most).rev() {
        // By scattering, and by how its light goes on, the tries that are wanted after that scattering.
        let mut wanted: BTreeMap<_, BTreeMap<_, f64>> = BTreeMap::new();
        let scattering = |sequence| scattering_of(sequence, number);
        for (target, tries) in targets.iter().zip(&tries) {
            if let Some((before, after)) = scattering(target.sequence) {
                *wanted.entry(before).or_default().entry(after).or_default() += tries[number + 1];
            }
        }
        for (target, tries) in targets.iter().zip(&mut tries) {
            let goes_on = scattering(target.sequence).and_then(|(before, _)| wanted.get(&before));
            if let Some(goes_on) = goes_on {
                let (most, sum) =
                    goes_on.values().fold((0.0_f64, 0.0), |(most, sum), &n| (most.max(n), sum + n));
                tries[number] = tries[number + 1] * most / sum;
            }
        }
    }
    tries
}

/// What a ray does up to a scattering, and where; to which side the ray then goes, and what it meets or where it ends.
type Scattering<'a> = ((u32, &'a [Step], u32), (StepKind, std::result::Result<u32, End>));

/// The scattering of a sequence that has so many before it.
fn scattering_of(sequence: &Sequence, number: usize) -> Option<Scattering<'_>> {
    let mut places = (0..).zip(&sequence.steps).filter(|(_, step)| step.kind.is_scattered());
    let (place, step) = places.nth(number)?;
    let next = sequence.steps.get(place + 1).map_or(Err(sequence.end), |next| Ok(next.surface));
    Some(((sequence.source, &sequence.steps[..place], step.surface), (step.kind, next)))
}

/// The probability with which guided rays try to take a sequence.
fn likelihood(guide: &Guide, ir: &SceneIr, sequence: &Sequence) -> f64 {
    let (mut node, mut likelihood) = (Guide::first_node(sequence.source), 1.0);
    for step in &sequence.steps {
        let choice = guide.choice(node, step.surface);
        let of_surface = ir.surfaces[step.surface as usize].scatter.as_ref().map(|scatter| scatter.fraction);
        let scatter = of_surface.map_or(0.0, |fraction| choice.scatter.unwrap_or(fraction));
        let reflect = choice.reflect.filter(|_| refracts(ir, step.surface));
        likelihood *= match step.kind {
            StepKind::Transmitted => (1.0 - scatter) * reflect.map_or(1.0, |reflect| 1.0 - reflect),
            StepKind::Reflected => (1.0 - scatter) * reflect.unwrap_or(1.0),
            StepKind::ScatteredThrough | StepKind::ScatteredBack => scatter,
        };
        node = guide.after(node, step.kind, step.surface);
    }
    likelihood
}

/// How a pilot's rays explore.
#[derive(Debug, Clone, Copy)]
struct Exploring {
    /// The share of the rays at each event.
    share: f64,
    /// With which probability they reflect, and with which they scatter.
    turn: f64,
}

/// What sequences do at a face, among those that come to a node.
#[derive(Debug, Clone, Copy, Default)]
struct Shares {
    reflected: f64,
    transmitted: f64,
    /// By which branch a sequence came to scatter is not known.
    scattered: f64,
}

impl Shares {
    /// Of the sequences that do not scatter, how many reflect.
    fn reflect(&self) -> Option<f64> {
        let passing = self.reflected + self.transmitted;
        (passing > 0.0).then(|| self.reflected / passing)
    }

    fn scatter(&self) -> f64 {
        self.scattered / (self.reflected + self.transmitted + self.scattered)
    }
}

/// The tree of sequences.
struct Tree {
    /// Per node, what sequences do at the faces that they meet.
    nodes: Vec<Node>,
    num_targets: usize,
}

#[derive(Debug, Default)]
struct Node {
    faces: BTreeMap<u32, Shares>,
    next: BTreeMap<Step, u32>,
    /// Reflections and scatterings so far.
    depth: usize,
}

impl Tree {
    /// A tree without sequences: the node that does not guide, and the nodes of the sources.
    fn new(ir: &SceneIr) -> Self {
        let nodes = (0..=ir.sources.len()).map(|_| Node::default()).collect();
        Tree { nodes, num_targets: 0 }
    }

    fn of(ir: &SceneIr, targets: &[Target]) -> Self {
        let mut tree = Tree::new(ir);
        for (target, tries) in targets.iter().zip(tries(targets)) {
            if !fits(tree.nodes.len() + target.sequence.steps.len() + MOST_EXPLORED, ir) {
                break;
            }
            tree.add(ir, target.sequence, &tries);
        }
        tree
    }

    /// Adds a sequence that is to be tried so often, by the scatterings that lie behind the ray.
    fn add(&mut self, ir: &SceneIr, sequence: &Sequence, tries: &[f64]) {
        self.num_targets += 1;
        let mut at = Guide::first_node(sequence.source) as usize;
        let mut scatterings = 0;
        for step in &sequence.steps {
            let share = tries[scatterings];
            if choices(ir, step.surface) > 0 {
                let shares = self.nodes[at].faces.entry(step.surface).or_default();
                match step.kind {
                    StepKind::Transmitted => shares.transmitted += share,
                    StepKind::Reflected => shares.reflected += share,
                    StepKind::ScatteredThrough | StepKind::ScatteredBack => shares.scattered += share,
                }
            }
            scatterings += usize::from(step.kind.is_scattered());
            if step.kind == StepKind::Transmitted {
                continue;
            }
            let (new, depth) = (self.nodes.len() as u32, self.nodes[at].depth + 1);
            let next = *self.nodes[at].next.entry(*step).or_insert(new);
            if next == new {
                self.nodes.push(Node { depth, ..Node::default() });
            }
            at = next as usize;
        }
    }

    /// The guide that follows the tree. Where rays also explore, those that leave the tree go on exploring.
    fn guide(&self, ir: &SceneIr, exploring: Option<Exploring>) -> Guide {
        let first = self.nodes.len() as u32;
        // The node of exploring rays that were turned so often.
        let explored = |depth: usize| match exploring {
            Some(_) if depth <= MOST_EXPLORED => first + depth as u32 - 1,
            _ => NO_NODE,
        };
        let choice = |(number, node): (usize, &Node), face: u32| {
            if number == NO_NODE as usize {
                return PLAIN;
            }
            let next = StepKind::ALL[1..].iter().map(|&kind| {
                let step = Step { kind, surface: face };
                node.next.get(&step).copied().unwrap_or_else(|| explored(node.depth + 1))
            });
            let explore = |learned: Option<f64>| match (exploring, learned) {
                (None, learned) => learned,
                (Some(exploring), None) => Some(exploring.turn).filter(|_| node.depth < MOST_EXPLORED),
                (Some(Exploring { share, turn }), Some(learned)) => {
                    Some((1.0 - share) * learned + share * turn)
                }
            };
            let shares = node.faces.get(&face);
            let reflect = explore(shares.and_then(Shares::reflect)).filter(|_| refracts(ir, face));
            let scatter = explore(shares.map(Shares::scatter)).filter(|_| scatters(ir, face));
            let mut after = [NO_NODE; 3];
            after.iter_mut().zip(next).for_each(|(place, next)| *place = next);
            Choice { reflect, scatter, next: after }
        };
        let exploring_nodes: Vec<Node> = match exploring {
            Some(_) => (1..=MOST_EXPLORED).map(|depth| Node { depth, ..Node::default() }).collect(),
            None => Vec::new(),
        };
        let nodes = self.nodes.iter().chain(&exploring_nodes).enumerate();
        let faces = 0..ir.surfaces.len() as u32;
        Guide::new(ir, nodes.flat_map(|node| faces.clone().map(move |face| choice(node, face))))
    }
}
