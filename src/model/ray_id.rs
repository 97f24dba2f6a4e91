//! Ids of rays: a launched ray has its place in the order of launch, its children by splitting have numbers beside it.
//!
//! `id = launched + number * 2^40`, where a launched ray has number 0. Where a ray is split it goes on as the reflected
//! branch with its own id; the transmitted branch is a new ray. Its number is the parent's number with bit
//! `bounce` set, the number of events before the split. So an id is a ray's lineage, and depends on nothing else.

/// Bits of an id that hold the launched ray.
const LAUNCHED_BITS: u32 = 40;

/// Most rays that can be launched where rays are split.
pub const MOST_LAUNCHED: u64 = 1 << LAUNCHED_BITS;

/// Bits of the number: ids keep within the positive 64-bit integers.
pub const NUMBER_BITS: u32 = 63 - LAUNCHED_BITS;

/// Independent scrambles of Sobol's points, by which a trace estimates its own error: the lowest bits of a launched
/// ray's id choose one. So every range of rays has its share of each. With more of them the error would be known
/// better, and each would have fewer points to spread evenly.
pub const NUM_REPLICATES: u32 = 16;

/// The id of a ray of a family.
pub fn of(launched: u64, number: u32) -> u64 {
    launched + (u64::from(number) << LAUNCHED_BITS)
}

/// Where a ray comes in lists: by launched ray, then by number within its family. Where no rays are split, an id is the
/// number of the launched ray alone, which may lie beyond [`MOST_LAUNCHED`].
pub fn order(id: u64, splits: bool) -> (u64, u64) {
    if splits { (id % MOST_LAUNCHED, id / MOST_LAUNCHED) } else { (id, 0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn families_stand_together_and_ids_stay_positive() {
        let mut ids = vec![of(1, 0), of(0, 3), of(1, 2), of(0, 0), of(0, 1)];
        ids.sort_by_key(|&id| order(id, true));
        assert_eq!(ids, [of(0, 0), of(0, 1), of(0, 3), of(1, 0), of(1, 2)]);
        assert_eq!(of(MOST_LAUNCHED - 1, (1 << NUMBER_BITS) - 1), i64::MAX as u64);
        assert_eq!(of(7, 0), 7);
    }

    #[test]
    fn ids_of_launched_rays_keep_their_order_beyond_the_bits_of_families() {
        let ids = [MOST_LAUNCHED - 1, MOST_LAUNCHED, MOST_LAUNCHED + 1, 5 * MOST_LAUNCHED];
        assert!(ids.is_sorted_by_key(|&id| order(id, false)));
    }
}
