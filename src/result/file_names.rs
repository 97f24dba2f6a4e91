//! Names of the files of a result.

/// Name of the document in the folder.
pub const REPORT: &str = "report.json";
/// Keys of a detector in that document that name its files.
pub const OF_DETECTOR: [&str; 3] = ["file", "picture", "color_picture"];
/// Name of the file of recorded paths.
pub const RAY_PATHS: &str = "ray_paths.npz";
/// Name of the file of a table of paths, as comma-separated values.
pub const PATHS: &str = "paths.csv";
/// Name of the file of maps of derivatives.
pub const GRADIENTS: &str = "gradients.npz";
/// Name of the file of raw sums.
pub const TALLY: &str = "tally.bin";
