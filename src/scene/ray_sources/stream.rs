//! The rays of a large file, which stay in the file until a dispatch begins with them.
//!
//! All rays are read once, to check them and to add up their shares of the light. Of the sums, one a block is kept: 5,000 numbers
//! for 2e7 rays. A draw then finds its block among the sums, and its ray by reading the block. Draws of many ids are sorted, so
//! that the file is read once for all of them, from its beginning to its end.

use crate::model::sources::rays::{Order, RayStream, StreamedRay};
use crate::scene::ray_files::{self, FileState, Picking, RayFile};
use crate::scene::ray_sources::taking::{Refusal, Taking};
use crate::{Error, Result};
use std::fmt;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Rays of a block.
const BLOCK: u64 = 1 << 12;
/// Draws that are looked up at once where ids come in turn: reading the file takes longer than so many draws. Rays in order
/// need no look ahead.
const DRAWS_AHEAD: usize = 1 << 20;
/// Relative difference of two rays' fluxes that is taken for rounding.
const ROUNDED: f64 = 1.0 / (1 << 20) as f64;

/// Sums of the rays' shares, at the end of each block.
#[derive(Debug)]
pub(super) struct Ends {
    order: Order,
    ends: Vec<f64>,
    sum: f64,
    num_rays: u64,
    /// The share of the first ray, which all rays have where they are taken in order.
    first_share: f64,
}

/// Rays that stay in their file.
pub(super) struct FileStream {
    path: PathBuf,
    taking: Taking,
    ends: Ends,
    /// The state of the file before all its rays were read.
    state: FileState,
    open: Mutex<Open>,
}

/// The file, and the rays that were looked up last.
struct Open {
    file: RayFile<File>,
    seed: u64,
    first_id: u64,
    rays: Vec<StreamedRay>,
}

impl Ends {
    pub(super) fn new(order: Order) -> Self {
        Ends { order, ends: Vec::new(), sum: 0.0, num_rays: 0, first_share: 0.0 }
    }

    /// Takes in the next ray of the file.
    pub(super) fn add(&mut self, number: u64, share: f64) -> std::result::Result<(), Refusal> {
        if number == 0 {
            self.first_share = share;
        }
        self.sum += self.step(number, share)?;
        self.num_rays = number + 1;
        if self.num_rays.is_multiple_of(BLOCK) {
            self.ends.push(self.sum);
        }
        Ok(())
    }

    /// What a ray adds to the sums: its share, or 1 where rays are taken in order.
    fn step(&self, number: u64, share: f64) -> std::result::Result<f64, Refusal> {
        if self.order == Order::Drawn {
            return Ok(share);
        }
        if (share - self.first_share).abs() <= ROUNDED * self.first_share && share > 0.0 {
            return Ok(1.0);
        }
        let problem = format!(
            "rays are taken in order, so all must have the same flux; ray {number} of the file has {share}, and ray 0 has {}",
            self.first_share
        );
        Err(Refusal::OfScene(problem, "take rays drawn by their flux, with \"order\": \"drawn\"".into()))
    }

    /// The sum at the end of a block.
    fn end_of(&self, block: usize) -> f64 {
        self.ends.get(block).copied().unwrap_or(self.sum)
    }

    /// Where the ray of a trace's ray lies among the sums.
    fn target(&self, id: u64, draw: &dyn Fn(u64) -> u64) -> f64 {
        const TWO_POW_52: f64 = (1_u64 << 52) as f64;
        match self.order {
            // Rounding may reach the sum, beyond which there is no ray.
            Order::Drawn => {
                (((draw(id) >> 12) as f64 + 0.5) / TWO_POW_52 * self.sum).min(self.sum.next_down())
            }
            Order::InOrder => (id % self.num_rays) as f64 + 0.5,
        }
    }
}

impl FileStream {
    pub(super) fn new(
        path: &Path,
        (file, state): (RayFile<File>, FileState),
        taking: Taking,
        ends: Ends,
    ) -> Self {
        let open = Open { file, seed: 0, first_id: 0, rays: Vec::new() };
        FileStream { path: path.to_owned(), taking, ends, state, open: Mutex::new(open) }
    }

    fn refused(&self, refusal: Refusal) -> Error {
        match refusal {
            Refusal::OfFile(error) => Error::file(&self.path, error.to_string()),
            Refusal::OfScene(problem, remedy) => Error::file(&self.path, format!("{problem}; {remedy}")),
        }
    }

    /// The rays of these ids.
    fn look_up(
        &self,
        file: &mut RayFile<File>,
        ids: impl Iterator<Item = u64>,
        draw: &dyn Fn(u64) -> u64,
    ) -> std::result::Result<Vec<StreamedRay>, Refusal> {
        if file.state()? != self.state {
            return Err(Refusal::OfFile(changed()));
        }
        let mut targets: Vec<(f64, u32)> = ids.map(|id| self.ends.target(id, draw)).zip(0..).collect();
        targets.sort_unstable_by(|(a, _), (b, _)| a.total_cmp(b));
        let nothing = StreamedRay { wavelength: None, position: [0.0; 3], direction: [0.0, 0.0, 1.0] };
        let found = vec![nothing; targets.len()];
        let mut lookup = Lookup { stream: self, sum: 0.0, targets: &targets, next: 0, found };
        while let Some((target, _)) = targets.get(lookup.next) {
            let block = self.ends.ends.partition_point(|end| end <= target);
            let first = block as u64 * BLOCK;
            lookup.sum = block.checked_sub(1).map_or(0.0, |before| self.ends.end_of(before));
            file.pick(first..(first + BLOCK).min(self.ends.num_rays), &mut lookup)?;
            if lookup.sum != self.ends.end_of(block) {
                return Err(Refusal::OfFile(changed()));
            }
        }
        Ok(lookup.found)
    }
}

/// Rays that are looked up.
struct Lookup<'a> {
    stream: &'a FileStream,
    /// The sum of shares up to the ray that was read last.
    sum: f64,
    /// Where draws fall among the sums, rising, and the places of their rays.
    targets: &'a [(f64, u32)],
    /// The first target that is still to be found.
    next: usize,
    found: Vec<StreamedRay>,
}

impl Picking<Refusal> for Lookup<'_> {
    fn wants(
        &mut self,
        number: u64,
        flux: f64,
        wavelength: Option<f64>,
    ) -> std::result::Result<bool, Refusal> {
        let FileStream { taking, ends, .. } = self.stream;
        self.sum += ends.step(number, taking.share(number, flux, wavelength)?)?;
        Ok(self.targets.get(self.next).is_some_and(|(target, _)| *target < self.sum))
    }

    fn take(&mut self, number: u64, ray: &ray_files::Ray) -> std::result::Result<(), Refusal> {
        let taken = self.stream.taking.ray(number, ray)?;
        while let Some((target, place)) = self.targets.get(self.next)
            && *target < self.sum
        {
            self.found[*place as usize] = taken.ray;
            self.next += 1;
        }
        Ok(())
    }
}

fn changed() -> ray_files::Error {
    ray_files::Error {
        place: "the rays".into(),
        problem: "they are not those that were there when the scene was read".into(),
        remedy: "leave the file as it is while it is traced".into(),
    }
}

impl RayStream for FileStream {
    fn rays(&self, seed: u64, ids: &[u64], draw: &dyn Fn(u64) -> u64) -> Result<Vec<StreamedRay>> {
        let mut open = self.open.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let Some(&first) = ids.first() else { return Ok(Vec::new()) };
        // In a list, an id may come more than once: a family of split rays has one.
        if !ids.windows(2).all(|pair| pair[1] == pair[0] + 1) {
            let found = self.look_up(&mut open.file, ids.iter().copied(), draw);
            return found.map_err(|refusal| self.refused(refusal));
        }
        if !open.holds(seed, first, ids.len()) {
            // Their memory is free before others take as much.
            open.rays = Vec::new();
            let ahead = match self.taking.order {
                Order::Drawn => ids.len().max(DRAWS_AHEAD),
                Order::InOrder => ids.len(),
            };
            let found = self.look_up(&mut open.file, first..first.saturating_add(ahead as u64), draw);
            let rays = found.map_err(|refusal| self.refused(refusal))?;
            (open.seed, open.first_id, open.rays) = (seed, first, rays);
        }
        let from = (first - open.first_id) as usize;
        Ok(open.rays[from..from + ids.len()].to_vec())
    }

    fn order(&self) -> Order {
        self.taking.order
    }
}

impl Open {
    fn end(&self) -> u64 {
        self.first_id.saturating_add(self.rays.len() as u64)
    }

    fn holds(&self, seed: u64, first: u64, num: usize) -> bool {
        seed == self.seed && first >= self.first_id && first.saturating_add(num as u64) <= self.end()
    }
}

impl fmt::Debug for FileStream {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} rays {:?}", self.ends.num_rays, self.taking.order)
    }
}
