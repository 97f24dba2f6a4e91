//! Trees of boxes in the module: whether there are any, where their rows lie, and how a walk keeps waiting groups.

use crate::model::Precision;
use crate::program::layout::row_table::RowTable;
use crate::program::wgsl::composition::Composition;

impl Composition<'_> {
    pub(super) fn has_trees(&self) -> bool {
        self.num_tree_rows() > 0
    }

    /// True if trees lie in an image.
    pub(super) fn has_texels(&self) -> bool {
        self.options.are_texels(self.num_tree_rows())
    }

    pub(super) fn has_triangles_among_trees(&self) -> bool {
        self.features.has_meshes() && self.precision() == Precision::F32
    }

    /// The number of rows of triangles that lie among the rows of trees.
    pub(super) fn num_triangle_rows(&self) -> usize {
        if self.has_triangles_among_trees() { self.triangles.num_rows() } else { 0 }
    }

    /// The number of rows of nodes, triangles and primitives.
    pub(super) fn num_tree_rows(&self) -> usize {
        let of_primitives = self.tree.as_ref().map_or(0, |tree| tree.num_rows(self.precision()));
        self.forest.num_rows() + self.num_triangle_rows() + of_primitives
    }

    /// The records of primitives that are stored with their tree.
    pub(super) fn tree_records(&self) -> Option<&RowTable> {
        self.tree.as_ref()?.records.as_ref()
    }

    /// True if a walk selects the waiting group among all levels. On processors this is faster than an index in each
    /// lane.
    pub(super) fn chooses_what_waits(&self) -> bool {
        const MOST_LEVELS: u32 = 32;
        self.has_texels() && self.forest.depth <= MOST_LEVELS
    }

    /// The twin of geometry/waiting.indexed.wgsl, which selects the waiting group among all levels.
    pub(super) fn waiting(&self) -> String {
        if !self.chooses_what_waits() {
            return String::new();
        }
        let levels = 1..self.forest.depth;
        let at = levels
            .clone()
            .map(|i| format!("    group = select(group, (*walk).waiting[{i}], place == {i}u);\n"));
        let at: String = at.collect();
        let put = levels.map(|i| {
            format!("    (*walk).waiting[{i}] = select((*walk).waiting[{i}], group, place == {i}u);\n")
        });
        let put: String = put.collect();
        format!(
            "fn waiting_at(walk: ptr<function, Walk>, place: u32) -> u32 {{\n    var group = (*walk).waiting[0];\n{at}    \
             return group;\n}}\nfn wait_at(walk: ptr<function, Walk>, place: u32, group: u32) {{\n    \
             (*walk).waiting[0] = select((*walk).waiting[0], group, place == 0u);\n{put}}}\n"
        )
    }
}
