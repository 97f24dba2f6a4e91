//! The table by which rays are guided: with which probability a ray reflects or scatters at a face, by what it did so far.
//!
//! What a ray did is a node of a tree. Each reflection and each scattering leads from a node to a node below it.
//! Passing through a face leads nowhere. A ray whose node has no way for what happened to it is guided no longer.

use crate::error::{Error, Result};
use crate::model::SceneIr;
use crate::model::sequence::StepKind;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::path::Path;

/// The share of rays that choose their branches as if there were no guide. So a weight is at most a plain ray's weight
/// over this share. Each path is drawn at least this often, compared with plain rays.
pub const PLAIN_SHARE: f64 = 0.25;

/// The node of rays that are not guided.
pub const NO_NODE: u32 = 0;

/// Words of a node at a face.
pub const WORDS: usize = 5;

/// The mark of a node that does not guide at a face. Beside the node after a reflection it means reflections, and beside the
/// node after scattering through it means scattering.
pub const IS_PLAIN: u32 = 1 << 31;

/// Most words of a table: 64 MiB.
const MOST_WORDS: usize = 1 << 24;

/// Version of the file.
const FORMAT: u32 = 2;

/// A guide, for scenes of some faces.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Guide {
    nsq_gpu_guide: u32,
    /// The names of the faces.
    faces: Vec<String>,
    /// The names of the sources. Node 1 + i is the node of new rays of source i.
    sources: Vec<String>,
    /// Five words for each node and each face: the probabilities of a reflection and of scattering in units of 2^-32,
    /// then three nodes. These are the nodes after a reflection, after scattering through, and after scattering back.
    words: Vec<u32>,
}

/// What a node asks for at a face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Choice {
    /// The probability of a reflection, among rays that do not scatter. `None`: the face's own.
    pub reflect: Option<f64>,
    /// The probability of scattering. `None`: the face's own.
    pub scatter: Option<f64>,
    /// The nodes after a reflection, after scattering through, and after scattering back.
    pub next: [u32; 3],
}

/// A choice that guides nowhere.
pub const PLAIN: Choice = Choice { reflect: None, scatter: None, next: [NO_NODE; 3] };

/// True if a table of so many nodes is no larger than a table may be.
pub fn fits(num_nodes: usize, ir: &SceneIr) -> bool {
    num_nodes * ir.surfaces.len().max(1) * WORDS <= MOST_WORDS
}

impl Guide {
    /// The guide of a scene that has these choices, node by node and face by face. The first node guides nowhere, and
    /// the nodes of the sources follow.
    pub fn new(ir: &SceneIr, choices: impl IntoIterator<Item = Choice>) -> Self {
        // A probability of 1 is one unit less.
        let units = |p: Option<f64>| p.map_or(0, |p| (p.clamp(0.0, 1.0) * 4_294_967_296.0) as u32);
        let mark = |p: Option<f64>| if p.is_none() { IS_PLAIN } else { 0 };
        let words =
            choices.into_iter().flat_map(|Choice { reflect, scatter, next: [reflected, through, back] }| {
                [units(reflect), units(scatter), reflected | mark(reflect), through | mark(scatter), back]
            });
        let mut words: Vec<u32> = words.collect();
        // A buffer is never empty.
        words.resize(words.len().max(WORDS), 0);
        Guide { nsq_gpu_guide: FORMAT, faces: faces(ir), sources: sources(ir), words }
    }

    /// A guide that leaves each choice to the faces. With a filter, rays still follow the one branch that can match.
    pub fn plain(ir: &SceneIr) -> Self {
        let num_nodes = 1 + ir.sources.len();
        Guide::new(ir, (0..num_nodes * ir.surfaces.len()).map(|_| PLAIN))
    }

    /// The words that the device reads.
    pub fn words(&self) -> &[u32] {
        &self.words
    }

    /// The number of nodes.
    pub fn num_nodes(&self) -> usize {
        self.words.len() / (WORDS * self.faces.len().max(1))
    }

    /// The node of new rays of a source.
    pub fn first_node(source: u32) -> u32 {
        1 + source
    }

    /// What a node asks for at a face.
    pub fn choice(&self, node: u32, face: u32) -> Choice {
        let at = (node as usize * self.faces.len() + face as usize) * WORDS;
        let probability =
            |units: u32, node: u32| (node & IS_PLAIN == 0).then_some(f64::from(units) / 4_294_967_296.0);
        match self.words.get(at..at + WORDS) {
            Some(&[reflect, scatter, reflected, through, back]) => Choice {
                reflect: probability(reflect, reflected),
                scatter: probability(scatter, through),
                next: [reflected & !IS_PLAIN, through & !IS_PLAIN, back],
            },
            _ => PLAIN,
        }
    }

    /// The node after an event, where it leads on.
    pub fn after(&self, node: u32, kind: StepKind, face: u32) -> u32 {
        let next = self.choice(node, face).next;
        match kind {
            StepKind::Transmitted => node,
            StepKind::Reflected => next[0],
            StepKind::ScatteredThrough => next[1],
            StepKind::ScatteredBack => next[2],
        }
    }

    /// The first 64 bits of the SHA-256 of what was learned, in hexadecimal digits.
    pub fn hash(&self) -> String {
        let mut hasher = Sha256::new();
        self.words.iter().for_each(|word| hasher.update(word.to_le_bytes()));
        hasher.finalize()[..8].iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// Refuses a guide of another scene.
    ///
    /// # Errors
    /// [`Error::Usage`] with the difference.
    pub fn check(&self, ir: &SceneIr) -> Result<()> {
        let differ = |what: &str, ours: &[String], theirs: &[String]| {
            let place = ours.iter().zip(theirs).position(|(one, other)| one != other);
            let difference = match place {
                Some(place) => {
                    format!("{what} {place} is `{}` there, and `{}` here", theirs[place], ours[place])
                }
                None => format!("it has {} {what}s, and the scene has {}", theirs.len(), ours.len()),
            };
            Err(Error::Usage(format!(
                "the guide was learned for another scene: {difference}; learn one by --guide"
            )))
        };
        let (ours, theirs) = (faces(ir), sources(ir));
        if ours != self.faces {
            return differ("face", &ours, &self.faces);
        }
        if theirs != self.sources {
            return differ("source", &theirs, &self.sources);
        }
        Ok(())
    }

    /// Reads a file that [`Guide::to_json`] gave.
    ///
    /// # Errors
    /// [`Error::File`] if it cannot be read, or is none.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(|error| Error::file(path, error))?;
        let guide: Guide = serde_json::from_str(&text)
            .map_err(|error| Error::file(path, format!("is no guide, as --guide-to writes it: {error}")))?;
        guide.problem().map_or(Ok(guide), |problem| Err(Error::file(path, problem)))
    }

    /// The text of a file.
    ///
    /// # Errors
    /// [`Error::Internal`] if it cannot be encoded.
    pub fn to_json(&self) -> Result<String> {
        serde_json::to_string(self)
            .map(|text| text + "\n")
            .map_err(|error| Error::Internal(error.to_string()))
    }

    /// What is wrong with a table, so that a device must not read it.
    pub fn problem(&self) -> Option<String> {
        if self.nsq_gpu_guide != FORMAT {
            return Some(format!(
                "is of format {}; this program reads format {FORMAT}, which guides scattering, too; learn it anew (--guide --guide-to)",
                self.nsq_gpu_guide
            ));
        }
        let row = WORDS * self.faces.len().max(1);
        let (num_words, num_nodes) = (self.words.len(), self.num_nodes());
        if num_words > MOST_WORDS
            || num_words % row != 0
            || !self.faces.is_empty() && num_nodes <= self.sources.len()
        {
            return Some(format!(
                "has {num_words} words; they should be a multiple of {row}, with a node for each source, and at most {MOST_WORDS}"
            ));
        }
        let nodes = self
            .words
            .chunks_exact(WORDS)
            .flat_map(|words| [words[2] & !IS_PLAIN, words[3] & !IS_PLAIN, words[4]]);
        nodes
            .into_iter()
            .find(|node| *node as usize >= num_nodes.max(1))
            .map(|node| format!("leads to node {node}, of {num_nodes}"))
    }
}

fn faces(ir: &SceneIr) -> Vec<String> {
    (0..ir.surfaces.len()).map(|surface| ir.surface_name(surface)).collect()
}

fn sources(ir: &SceneIr) -> Vec<String> {
    ir.sources.iter().map(|source| source.name.clone()).collect()
}
