// A ray meets a detector at most once: detectors end the rays that they record, and no ray is split. Twin of
// visits.on.wgsl.

fn meet(index: u32) {}

fn taken_by_detector() -> real {
    return 0.0;
}

fn taken_by_cell(cell: u32) -> real {
    return 0.0;
}

fn taken_by_pixel(detector: Detector, base: u32, column: i32, row: i32) -> real {
    return 0.0;
}

fn remember(cell: u32, base: u32, position: vec2<real>, weight: real) {}
