//! Which path light took: a table with the strongest paths first.

use crate::format::csv_text;
use crate::model::path_filter::MOST_PARTS;
use crate::model::sequence::{End, Sequence, Step, StepKind};
use crate::model::surface_optics::branches_scatter;
use crate::model::{PathFilter, SceneIr};
use crate::result::{
    CoatingRank, FewRays, FluxUnit, PathSum, PathTally, QUANTA_PER_WEIGHT, Recoated, Recoating, Tally,
};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Which sequences make one row.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Grouping {
    /// Each sequence is a row.
    #[default]
    Sequence,
    /// Sequences whose light was reflected and scattered by the same faces in the same order are a row: a ghost.
    Faces,
    /// Sequences with equally many reflections and scatterings are a row.
    Order,
}

/// By what rows are sorted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Sorting {
    /// The most flux first.
    #[default]
    Flux,
    /// The highest peak of irradiance first; then rows without one, by flux.
    Peak,
}

/// One row: the light of one path, or of several that belong together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LightPath {
    /// The place in the table, from 1 on.
    pub rank: u32,
    /// Flux \[W\].
    pub flux: f64,
    /// The fraction of all light that came to the row's end, such as its detector.
    pub share: f64,
    /// Standard error of the flux \[W\]; null where it is not known. Where a ray can bring light by several of the row's
    /// sequences, it is an upper bound.
    pub standard_error: Option<f64>,
    /// If the flux rests on fewer than ten rays: their number, `rests_on`, and a bound of the flux with 95 %
    /// confidence, `upper_bound_95`. Otherwise both are missing.
    #[serde(flatten)]
    pub few_rays: Option<FewRays>,
    /// Rays that brought the light.
    pub num_rays: u64,
    /// Where rays were guided: so many plain rays would bring the same relative error, if chance gave them all alike.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plain_rays: Option<f64>,
    /// Specular reflections along the path.
    pub reflections: u32,
    /// Scatterings along the path.
    pub scatterings: u32,
    /// The detector; null where the light ended elsewhere.
    pub detector: Option<String>,
    /// The path, from its source to its end. Where several are a row, `*` stands for what they need not share.
    pub sequence: String,
    /// What happened, and where: `T` transmitted, `R` reflected, `ST` scattered through, `SR` scattered back,
    /// `A` absorbed, `M` missed. Where several paths are a row, only what they share.
    pub steps: Vec<[String; 2]>,
    /// An expression that keeps this row's light alone (`--where`). Null where the light ended on no detector, or where
    /// a name cannot be written in an expression. Also null for sequences of more parts than an expression has.
    #[serde(rename = "where")]
    pub filter: Option<String>,
    /// The centre of the light on the detector, in the detector's frame \[mm\]; null where it was not summed up.
    pub centroid: Option<[f64; 2]>,
    /// The root of the mean square of distances from the centroid \[mm\]; null where it was not summed up.
    pub rms_radius: Option<f64>,
    /// The irradiance of the row's brightest pixel \[W/mm^2\]; null where the row has no map.
    pub peak_irradiance: Option<f64>,
}

/// Light without a row of its own, by its end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OtherLight {
    /// The detector; null where the light ended elsewhere.
    pub detector: Option<String>,
    /// Where the light ended.
    pub end: String,
    /// Flux \[W\].
    pub flux: f64,
    /// The fraction of all light that came to this end.
    pub share: f64,
    /// Rays that brought the light.
    pub num_rays: u64,
}

/// The table.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct PathTable {
    /// Which sequences make a row.
    pub group: Grouping,
    /// The rows, sorted.
    pub paths: Vec<LightPath>,
    /// Light without a row, by its end.
    pub other: Vec<OtherLight>,
    /// True if there were more sequences than the table may have rows.
    #[serde(default)]
    pub is_closed: bool,
    /// Faces whose coatings are others than in the trace. The rows have the new coatings.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub recoated: Vec<Recoated>,
    /// The faces that ghosts meet, by how much their coatings matter; missing unless asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coatings: Option<Vec<CoatingRank>>,
    /// What the user should know of new coatings, or of the coatings' rank.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub coating_warnings: Vec<String>,
}

/// Where the light of a sequence lies on its detector, about a point: sums of weight times x, y and their squares.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct PlaceMoments {
    /// The point \[mm\].
    pub about: [f64; 2],
    /// The unit of distances \[mm\].
    pub size: f64,
    /// Sums of weight times distance, in units of 2^-52.
    pub first: [i128; 2],
    /// The sum of weight times the square of the distance, in units of 2^-52.
    pub second: i128,
}

/// A row, with the sequences that make it.
#[derive(Debug, Clone)]
pub struct Group<'a> {
    /// What the sequences share.
    pub row: LightPath,
    /// The sequences, ascending.
    pub sequences: Vec<&'a Sequence>,
    /// What new coatings multiply the light of each sequence by. `None` if sequences have different factors.
    pub factor: Option<f64>,
}

/// The light of a sequence, with the coatings that are asked for.
#[derive(Debug, Clone, Copy)]
struct Member<'a> {
    sequence: &'a Sequence,
    /// What was traced, times `factor` over the largest factor of the row.
    sum: PathSum,
    factor: f64,
}

/// Rows of a table up to which expressions are checked where names are not plain words: each is asked of all rows.
const MOST_CHECKED: usize = 1 << 12;

/// What the sequences of a row have in common.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Common<'a> {
    Sequence(&'a Sequence),
    Faces(End, Vec<Step>),
    Order(End, usize, usize),
}

/// Groups the rows of a tally, with the most flux first. Rows of equal flux keep the order of their sequences.
pub fn groups<'a>(
    ir: &SceneIr,
    tally: &Tally,
    sums: &'a PathTally,
    unit: FluxUnit,
    grouping: Grouping,
    has_errors: bool,
    recoating: &Recoating,
) -> Vec<Group<'a>> {
    let mut groups: BTreeMap<Common, Vec<Member>> = BTreeMap::new();
    for (sequence, sum) in &sums.rows {
        let common = match grouping {
            Grouping::Sequence => Common::Sequence(sequence),
            Grouping::Faces => Common::Faces(sequence.end, turns(sequence)),
            Grouping::Order => Common::Order(sequence.end, sequence.reflections(), sequence.scatterings()),
        };
        let member = Member { sequence, sum: *sum, factor: recoating.factor(sequence) };
        groups.entry(common).or_default().push(member);
    }
    let launched = tally.rays.counts(ir.sources.len());
    let totals = totals(sums, recoating);
    let branches_scatter = branches_scatter(ir);
    let is_plain = names_are_plain(ir);
    // Some names cannot be written in an expression, or stand for others as well, and some sequences are too long.
    let keeps_alone = |text: &String, members: &[Member]| {
        if is_plain {
            return text.split(" > ").count() <= MOST_PARTS;
        }
        let is_member = |sequence: &Sequence| members.iter().any(|member| member.sequence == sequence);
        sums.rows.len() <= MOST_CHECKED
            && PathFilter::parse(text, ir)
                .is_ok_and(|filter| sums.rows.keys().all(|row| filter.keeps(row) == is_member(row)))
    };
    let launched_flux = unit.watts(tally.launched.quanta);
    let absorbs = |end: End| end.detector().is_none_or(|number| ir.detectors[number].absorb);
    let mut rows: Vec<(u128, Group)> = groups
        .into_iter()
        .map(|(common, mut members)| {
            let first = members[0].sequence;
            let largest = scale(&mut members);
            let mut sum = PathSum::default();
            members.iter().for_each(|member| sum += member.sum);
            let is_known = has_errors
                && !sums.squares_overflowed
                && !(branches_scatter && members.iter().any(|member| member.sequence.scatterings() > 0));
            let error = is_known.then(|| {
                let quanta = error_of(&members, &launched, first.end.is_exclusive(ir));
                unit.watts_of_weight(quanta / QUANTA_PER_WEIGHT) * largest
            });
            let (sequence, steps, filter) = described(ir, &common, first);
            let few_rays = sum.brought(!sums.squares_overflowed).few_rays(tally.launched.mean_weight(), unit);
            // Light that a coating takes to the last bit is known to be none.
            let few_rays = few_rays.filter(|_| largest > 0.0).map(|few| few.scaled(largest));
            let row = LightPath {
                rank: 0,
                flux: unit.watts(sum.quanta) * largest,
                share: sum.quanta as f64 * largest / totals[&first.end],
                standard_error: error.filter(|error| error.is_finite()),
                few_rays: few_rays
                    .map(|few| if absorbs(first.end) { few.at_most(launched_flux) } else { few }),
                num_rays: sum.count,
                plain_rays: None,
                reflections: first.reflections() as u32,
                scatterings: first.scatterings() as u32,
                detector: first.end.detector().map(|number| ir.detectors[number].name.clone()),
                sequence,
                steps,
                filter: filter.filter(|text| keeps_alone(text, &members)),
                centroid: None,
                rms_radius: None,
                peak_irradiance: None,
            };
            let factor = members.iter().all(|member| member.factor == largest).then_some(largest);
            let sequences = members.iter().map(|member| member.sequence).collect();
            (sum.quanta, Group { row, sequences, factor })
        })
        .collect();
    match recoating.is_empty() {
        true => rows.sort_by_key(|(quanta, _)| std::cmp::Reverse(*quanta)),
        false => rows.sort_by(|(_, a), (_, b)| b.row.flux.total_cmp(&a.row.flux)),
    }
    let ranked =
        (1..).zip(rows).map(|(rank, (_, group))| Group { row: LightPath { rank, ..group.row }, ..group });
    ranked.collect()
}

/// Scales the sums of a row by their factors, relative to the largest factor, which is returned. Sums are whole
/// numbers, which small factors would round. Where all factors are one number, the sums stay as they are.
fn scale(members: &mut [Member]) -> f64 {
    let largest = members.iter().map(|member| member.factor).fold(0.0, f64::max);
    for Member { sum, factor, .. } in members.iter_mut().filter(|member| member.factor != largest) {
        let relative = *factor / largest;
        sum.quanta = (sum.quanta as f64 * relative).round() as u128;
        sum.squares = (sum.squares as f64 * relative * relative).ceil() as u128;
    }
    largest
}

/// All light that came to each end \[quanta\], at least 1.
fn totals(sums: &PathTally, recoating: &Recoating) -> BTreeMap<End, f64> {
    if recoating.is_empty() {
        return sums.totals().into_iter().map(|(end, sum)| (end, sum.quanta.max(1) as f64)).collect();
    }
    let mut totals: BTreeMap<End, f64> = BTreeMap::new();
    let rows = sums.rows.iter().map(|(path, sum)| (path.end, sum.quanta as f64 * recoating.factor(path)));
    let other = sums.other.iter().map(|(end, sum)| (*end, sum.quanta as f64));
    rows.chain(other).for_each(|(end, quanta)| *totals.entry(end).or_default() += quanta);
    totals.values_mut().for_each(|total| *total = total.max(1.0));
    totals
}

/// True if every name can be written in an expression, and stands for itself alone.
fn names_are_plain(ir: &SceneIr) -> bool {
    let surfaces: Vec<String> = (0..ir.surfaces.len()).map(|surface| ir.surface_name(surface)).collect();
    let others = ir.sources.iter().map(|source| &source.name);
    let others = others.chain(ir.detectors.iter().map(|detector| &detector.name));
    let is_plain = |name: &String| {
        !name.is_empty() && !name.contains(['*', '"', '>', ' ']) && !name.chars().any(char::is_control)
    };
    let components: BTreeSet<&str> =
        surfaces.iter().filter_map(|name| Some(name.rsplit_once('.')?.0)).collect();
    let distinct: BTreeSet<&String> = surfaces.iter().collect();
    surfaces.iter().chain(others).all(is_plain)
        && distinct.len() == surfaces.len()
        && !surfaces.iter().any(|name| components.contains(name.as_str()))
}

/// The standard error of a sum over sequences \[quanta\]. Where each ray comes by one sequence at most, the squares of the
/// rays of a source add up. Else the errors of the sequences do, which are never too small.
fn error_of(members: &[Member], launched: &[u64], is_exclusive: bool) -> f64 {
    let mut of_sources: BTreeMap<u32, PathSum> = BTreeMap::new();
    for Member { sequence, sum, .. } in members {
        *of_sources.entry(sequence.source).or_default() += *sum;
    }
    let error = |source: u32, sum: &PathSum| {
        let num_rays = launched[source as usize];
        let scale = num_rays as f64 / (num_rays as f64 - 1.0);
        (sum.variance(num_rays) * scale).sqrt()
    };
    match is_exclusive || members.len() == 1 {
        true => of_sources.iter().map(|(source, sum)| error(*source, sum).powi(2)).sum::<f64>().sqrt(),
        false => members.iter().map(|member| error(member.sequence.source, &member.sum)).sum(),
    }
}

/// The events that turned the light otherwise than by refraction.
fn turns(sequence: &Sequence) -> Vec<Step> {
    sequence.steps.iter().filter(|step| step.kind != StepKind::Transmitted).copied().collect()
}

/// The text, the steps and the filter of a row.
fn described(ir: &SceneIr, common: &Common, first: &Sequence) -> (String, Vec<[String; 2]>, Option<String>) {
    let is_detected = first.end.detector().is_some();
    let end = first.end.text(ir);
    let counts = format!("reflections == {} and scatterings == {}", first.reflections(), first.scatterings());
    match common {
        Common::Sequence(sequence) => {
            let text = sequence.text(ir);
            let filter = is_detected.then(|| format!("sequence(\"{text}\")"));
            (text, sequence.named_steps(ir), filter)
        }
        Common::Faces(_, turns) => {
            let steps = Sequence { steps: turns.clone(), ..first.clone() }.named_steps(ir);
            let turns = steps.iter().filter(|[letters, _]| !["A", "M"].contains(&letters.as_str()));
            let mut parts: Vec<String> = vec!["*".into()];
            for [letters, name] in turns {
                parts.extend([format!("{letters} {name}"), "*".into()]);
            }
            parts.push(end);
            let text = parts.join(" > ");
            let filter = is_detected.then(|| format!("sequence(\"{text}\") and {counts}"));
            (text, steps, filter)
        }
        Common::Order(..) => {
            let plural =
                |number: usize, word: &str| format!("{number} {word}{}", if number == 1 { "" } else { "s" });
            let (reflections, scatterings) = (first.reflections(), first.scatterings());
            let text = format!(
                "{}, {} > {end}",
                plural(reflections, "reflection"),
                plural(scatterings, "scattering")
            );
            let filter = is_detected.then(|| format!("{counts} and sequence(\"* > {end}\")"));
            (text, Vec::new(), filter)
        }
    }
}

impl LightPath {
    /// The same with what guided rays were worth, of a trace that launched this flux \[W\]. Of plain rays a share F / launched brings
    /// the row's flux F, with the relative variance launched / F over their number.
    #[must_use]
    pub fn with_worth(self, launched: f64) -> Self {
        let worth = |error: f64| (error > 0.0).then(|| launched * self.flux / (error * error));
        LightPath { plain_rays: self.standard_error.and_then(worth), ..self }
    }

    /// A title for pictures: the path, and of a long one what it did beside passing through faces.
    pub fn title(&self) -> String {
        const MOST_LETTERS: usize = 64;
        if self.sequence.chars().count() <= MOST_LETTERS {
            return self.sequence.clone();
        }
        let mut parts: Vec<&str> = Vec::new();
        for part in self.sequence.split(" > ") {
            let part = if part.starts_with("T ") { "…" } else { part };
            if part != "…" || parts.last() != Some(&"…") {
                parts.push(part);
            }
        }
        parts.join(" > ")
    }
}

impl PathTable {
    /// The table of rows, with the light that has no row: of one detector, or of all.
    pub fn new(
        ir: &SceneIr,
        sums: &PathTally,
        unit: FluxUnit,
        grouping: Grouping,
        detector: Option<usize>,
        rows: impl IntoIterator<Item = LightPath>,
        recoating: &Recoating,
    ) -> PathTable {
        let totals = totals(sums, recoating);
        let is_listed = |(end, _): &(&End, &PathSum)| detector.is_none() || end.detector() == detector;
        let other = sums.other.iter().filter(is_listed).map(|(end, sum)| OtherLight {
            detector: end.detector().map(|number| ir.detectors[number].name.clone()),
            end: end.text(ir),
            flux: unit.watts(sum.quanta),
            share: sum.quanta as f64 / totals[end],
            num_rays: sum.count,
        });
        PathTable {
            group: grouping,
            paths: rows.into_iter().collect(),
            other: other.collect(),
            is_closed: sums.is_closed,
            recoated: recoating.recoated(),
            coatings: None,
            coating_warnings: Vec::new(),
        }
    }

    /// As comma-separated values with a heading.
    pub fn to_csv(&self) -> String {
        let mut text = String::from(
            "rank,flux_W,share,standard_error_W,num_rays,reflections,scatterings,detector,centroid_x_mm,centroid_y_mm,\
             rms_radius_mm,peak_irradiance_W_mm2,sequence,rests_on,upper_bound_95_W\n",
        );
        let number = |value: Option<f64>| value.map_or(String::new(), |value| format!("{value:e}"));
        for row in &self.paths {
            let fields = [
                row.rank.to_string(),
                format!("{:e}", row.flux),
                format!("{:e}", row.share),
                number(row.standard_error),
                row.num_rays.to_string(),
                row.reflections.to_string(),
                row.scatterings.to_string(),
                csv_text(row.detector.as_deref().unwrap_or_default()),
                number(row.centroid.map(|[x, _]| x)),
                number(row.centroid.map(|[_, y]| y)),
                number(row.rms_radius),
                number(row.peak_irradiance),
                csv_text(&row.sequence),
                row.few_rays.map_or(String::new(), |few| few.rests_on.to_string()),
                number(row.few_rays.map(|few| few.upper_bound_95)),
            ];
            text += &(fields.join(",") + "\n");
        }
        text
    }
}

impl PlaceMoments {
    /// The places of so much of the light.
    pub(crate) fn scaled(self, factor: f64) -> Self {
        let scaled = |sum: i128| (sum as f64 * factor).round() as i128;
        PlaceMoments { first: self.first.map(scaled), second: scaled(self.second), ..self }
    }

    /// The centroid and the RMS radius of light \[mm\] that several sequences brought: their sums and their places.
    pub fn spot(parts: &[(PathSum, PlaceMoments)]) -> Option<([f64; 2], f64)> {
        let weight: f64 = parts.iter().map(|(sum, _)| sum.quanta as f64).sum();
        if weight == 0.0 {
            return None;
        }
        let mean = |part: &(PathSum, PlaceMoments), axis: usize| {
            let (sum, places) = part;
            places.about[axis] + places.size * (places.first[axis] as f64 / sum.quanta as f64)
        };
        let share = |(sum, _): &(PathSum, PlaceMoments)| sum.quanta as f64 / weight;
        let lit: Vec<(PathSum, PlaceMoments)> =
            parts.iter().filter(|(sum, _)| sum.quanta > 0).copied().collect();
        let centroid = [0, 1].map(|axis| lit.iter().map(|part| share(part) * mean(part, axis)).sum::<f64>());
        let square: f64 = lit
            .iter()
            .map(|part| {
                let (sum, places) = part;
                let quanta = sum.quanta as f64;
                let offsets = places.first.map(|first| first as f64 / quanta);
                let within = places.second as f64 / quanta - offsets[0].powi(2) - offsets[1].powi(2);
                let within = within * places.size * places.size;
                let between = (mean(part, 0) - centroid[0]).powi(2) + (mean(part, 1) - centroid[1]).powi(2);
                share(part) * (within.max(0.0) + between)
            })
            .sum();
        Some((centroid, square.sqrt()))
    }
}
