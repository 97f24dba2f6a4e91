// There are no second moments: nobody asked for them, or they follow from the counts of hits. Twin of moments.on.wgsl.

fn add_total_moments(weight: real, detector: Detector, index: u32) {}

fn add_cell_moment(weight: real, detector: Detector, cell: u32) {}

fn add_pixel_moments(weight: real, detector: Detector, p: vec3<real>, pixel: u32, base: u32, stride: u32) {}
