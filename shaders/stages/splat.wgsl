// Stage splat: a detector records the ray that has arrived on it.

// A ray arrives on a detector. An absorbing detector ends the ray, and records it after the loop over events. A
// transmissive detector records the ray in passing.
fn arrive(ray: ptr<function, Ray>, index: u32) {
    if !HAS_TRANSMISSIVE {
        (*ray).fate = DETECTED;
        return;
    }
    if detector_of(index).absorb != 0u {
        (*ray).fate = DETECTED;
    } else {
        splat(*ray, index, false);
        log_pass((*ray).index);
        note_passing(ray, detector_of(index));
    }
}

// Records the ray. `ends` is true if the ray ends on the detector, and false if it passes.
fn plain_splat(ray: Ray, index: u32, ends: bool) {
    let detector = detector_for(ray.key, detector_of(index));
    add_total_moments(ray.weight, detector, index);
    record(ray, detector, index, ends);
}

fn deposit_arrival(cell: u32, weight: real, ends: bool) {
    if ends || LOGS_PASSES {
        end_in(cell, weight);
    } else {
        deposit_counted(cell, weight);
    }
}

fn local_position(ray: Ray, detector: Detector) -> vec3<real> {
    let origin = vec3<real>(detector.origin_x, detector.origin_y, detector.origin_z);
    return to_detector(detector, ray.position - origin);
}

// The pixel that holds x. Edges are edge_i = i * pitch - half, and each pixel owns its lower edge. Positions outside
// the map belong to the edge pixels. The division only guesses the pixel; comparison with the edges decides.
fn pixel_of(x: real, half: real, pitch: real, num_pixels: u32) -> u32 {
    let last = i32(num_pixels) - 1;
    var i = clamp(i32(floor((x + half) / pitch)), 0, last);
    if i > 0 && x < real(i) * pitch - half {
        i -= 1;
    } else if i < last && x >= real(i + 1) * pitch - half {
        i += 1;
    }
    return u32(i);
}

fn hit_pixel(p: vec3<real>, detector: Detector) -> u32 {
    let ix = pixel_of(p.x, detector.half_width, detector.pitch_x, detector.num_x);
    let iy = pixel_of(p.y, detector.half_height, detector.pitch_y, detector.num_y);
    return iy * detector.num_x + ix;
}

// Deposits flux in cell base + pixel * stride. The stride is 1 for an irradiance map, and the number of wavelength bins
// for a spectral map.
fn splat_pixels(ray: Ray, detector: Detector, p: vec3<real>, base: u32, stride: u32, ends: bool) {
    let pixel = hit_pixel(p, detector);
    if HAS_BILINEAR && detector.splat == SPLAT_BILINEAR {
        let taps = bilinear_taps(detector, p, base, stride, base + pixel * stride);
        if ends || LOGS_PASSES {
            end_in_taps(taps, ray.weight);
        } else {
            deposit_taps(taps, ray.weight);
        }
    } else if HAS_GAUSSIAN && detector.splat == SPLAT_GAUSSIAN {
        count(base + pixel * stride);
        splat_gaussian(ray.weight, detector, p, base, stride);
    } else if HAS_HARD {
        deposit_arrival(base + pixel * stride, ray.weight, ends);
    }
    add_pixel_moments(ray.weight, detector, p, pixel, base, stride);
}

const SPLAT_HARD: u32 = 0u;
const SPLAT_BILINEAR: u32 = 1u;
const SPLAT_GAUSSIAN: u32 = 2u;

// Position in pixels from the centre of pixel (0, 0).
fn pixel_position(p: vec3<real>, detector: Detector) -> vec2<real> {
    return vec2<real>(
        (p.x + detector.half_width) / detector.pitch_x - 0.5,
        (p.y + detector.half_height) / detector.pitch_y - 0.5,
    );
}

// The cell of a tap. Taps beyond the map fall into its edge pixels.
fn tap_cell(ix: i32, iy: i32, detector: Detector, base: u32, stride: u32) -> u32 {
    let x = u32(clamp(ix, 0, i32(detector.num_x) - 1));
    let y = u32(clamp(iy, 0, i32(detector.num_y) - 1));
    return base + (y * detector.num_x + x) * stride;
}

// The four taps of a bilinear splat: pixels (x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1). `fractions` is the position
// between the pixels, in 0..1.
struct FourTaps {
    // The cell of the pixel that was hit, which is one of the four.
    hit: u32,
    cells: vec4<u32>,
    fractions: vec2<real>,
    // The position, in pixels from the centre of pixel (0, 0).
    position: vec2<real>,
}

fn bilinear_taps(detector: Detector, p: vec3<real>, base: u32, stride: u32, hit: u32) -> FourTaps {
    let position = pixel_position(p, detector);
    let corner_x = floor(position.x);
    let corner_y = floor(position.y);
    let fractions = vec2<real>(position.x - corner_x, position.y - corner_y);
    let ix = i32(corner_x);
    let iy = i32(corner_y);
    let cells = vec4<u32>(
        tap_cell(ix, iy, detector, base, stride),
        tap_cell(ix + 1, iy, detector, base, stride),
        tap_cell(ix, iy + 1, detector, base, stride),
        tap_cell(ix + 1, iy + 1, detector, base, stride),
    );
    return FourTaps(hit, cells, fractions, position);
}

// The weight that each of the first three taps takes. The twins on the host are `parts` and `first_shares` in
// cpu::log::reals.
fn first_shares(weight: real, f: vec2<real>) -> vec3<real> {
    return vec3<real>(
        weight * ((1.0 - f.x) * (1.0 - f.y)), weight * (f.x * (1.0 - f.y)), weight * ((1.0 - f.x) * f.y),
    );
}

// Deposits the taps. The last tap takes what the others left, so that the taps add up to the weight exactly.
fn plain_deposit_taps(taps: FourTaps, weight: real) {
    count(taps.hit);
    let shares = first_shares(weight, taps.fractions);
    var rest = quantize_counted(weight);
    deposit_tap(taps.cells.x, shares.x, &rest);
    deposit_tap(taps.cells.y, shares.y, &rest);
    deposit_tap(taps.cells.z, shares.z, &rest);
    deposit(taps.cells.w, rest);
}

// Deposits a Gaussian splat: shares exp(-(i - position)^2 / (2 sigma^2)) over the taps within the radius, renormalised.
fn splat_gaussian(weight: real, detector: Detector, p: vec3<real>, base: u32, stride: u32) {
    splat_gaussian_at(weight, detector, pixel_position(p, detector), base, stride);
}

fn splat_gaussian_at(weight: real, detector: Detector, position: vec2<real>, base: u32, stride: u32) {
    let ix = i32(floor(position.x));
    let iy = i32(floor(position.y));
    let radius = i32(detector.splat_radius);
    var sum_x: real = 0.0;
    var sum_y: real = 0.0;
    for (var i = -radius; i <= radius; i++) {
        sum_x += gaussian_share(ix + i, position.x, detector);
        sum_y += gaussian_share(iy + i, position.y, detector);
    }
    var rest = quantize_counted(weight);
    var j = -radius;
    loop {
        let share_y = gaussian_share(iy + j, position.y, detector) / sum_y;
        var i = -radius;
        loop {
            if always_true() & (i <= radius) & (j <= radius) {
                let share = gaussian_share(ix + i, position.x, detector) / sum_x * share_y;
                deposit_tap(tap_cell(ix + i, iy + j, detector, base, stride), weight * share, &rest);
            }
            i += 1;
            if i > radius {
                break;
            }
        }
        j += 1;
        if j > radius {
            break;
        }
    }
    deposit(tap_cell(ix, iy, detector, base, stride), rest);
}

fn gaussian_share(i: i32, position: real, detector: Detector) -> real {
    let offset = real(i) - position;
    return exp_real(-detector.splat_falloff * offset * offset);
}
