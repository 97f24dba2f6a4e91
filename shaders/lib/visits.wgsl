// What a launched ray left on detectors that let it pass, or its children after it was split: its later deposits on them
// are correlated with these. So many visits are known each by its place; of the others only the weight is, and what they
// left is taken for the whole of it wherever the ray comes again: the second moment is then too large, never too small.
// An invocation traces one ray, from its birth to its end, where this file is used.

const MAX_VISITS: u32 = 8u;

struct Visit {
    // The detector, by its first cell.
    sensor: u32,
    // The cell that took all, or NONE where the weight was spread about a position from the cell `base` on.
    cell: u32,
    base: u32,
    x: real,
    y: real,
    weight: real,
}

var<private> visits: array<Visit, MAX_VISITS>;
var<private> num_visits: u32 = 0u;
var<private> forgotten_weight: real;

fn remember(sensor: Sensor, cell: u32, base: u32, position: vec2<real>, weight: real) {
    if num_visits < MAX_VISITS {
        visits[num_visits] = Visit(sensor.cell, cell, base, position.x, position.y, weight);
        num_visits += 1u;
    } else {
        forgotten_weight += weight;
    }
}

fn taken_by_sensor(sensor: Sensor) -> real {
    var taken = forgotten_weight;
    for (var i = 0u; i < num_visits; i++) {
        taken += choose(0.0, visits[i].weight, visits[i].sensor == sensor.cell);
    }
    return taken;
}

fn taken_by_cell(cell: u32) -> real {
    var taken = forgotten_weight;
    for (var i = 0u; i < num_visits; i++) {
        taken += choose(0.0, visits[i].weight, visits[i].cell == cell);
    }
    return taken;
}

fn taken_by_pixel(sensor: Sensor, base: u32, column: i32, row: i32) -> real {
    var taken = forgotten_weight;
    for (var i = 0u; i < num_visits; i++) {
        let visit = visits[i];
        if (visit.sensor == sensor.cell) & (visit.base == base) {
            let share_x = pixel_share(taps_of(visit.x, sensor), column, i32(sensor.num_x) - 1, sensor);
            let share_y = pixel_share(taps_of(visit.y, sensor), row, i32(sensor.num_y) - 1, sensor);
            taken += visit.weight * share_x * share_y;
        }
    }
    return taken;
}
