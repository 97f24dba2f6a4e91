//! Structs shared with the host: what it writes and reads lies where the shaders have it, in both precisions.

use crate::twins::constant;
use crate::variants::{Choice, Tier, Variant, everything, everything_in_buffers};
use naga::proc::Layouter;
use naga::{Module, Scalar, ScalarKind, TypeInner};
use nsq_gpu::model::ShapeKind;
use nsq_gpu::model::{SceneIr, Shape};
use nsq_gpu::program::layout::bindings;
use nsq_gpu::program::layout::reals::StructLayout;
use nsq_gpu::program::{PathSampling, Precision, Program, RayRange, Sampler};

/// A field of a struct of a module.
#[derive(Debug, PartialEq)]
struct Field {
    name: String,
    offset: usize,
    size: usize,
    real: bool,
}

/// The fields, and the size of the struct.
fn fields(module: &Module, name: &str) -> (Vec<Field>, usize) {
    let mut layouter = Layouter::default();
    layouter.update(module.to_ctx()).unwrap();
    let (handle, kind) = module.types.iter().find(|(_, kind)| kind.name.as_deref() == Some(name)).unwrap();
    let TypeInner::Struct { members, .. } = &kind.inner else { panic!("{name} is not a struct") };
    let field = |member: &naga::StructMember| {
        let (Some(scalar), name) = (scalar(&module.types[member.ty].inner), member.name.clone().unwrap())
        else {
            panic!("{name}.{:?} is no scalar: its alignment is not its size", member.name)
        };
        Field {
            name,
            offset: member.offset as usize,
            size: usize::from(scalar.width),
            real: scalar.kind == ScalarKind::Float,
        }
    };
    (members.iter().map(field).collect(), layouter[handle].to_stride() as usize)
}

fn scalar(inner: &TypeInner) -> Option<Scalar> {
    match inner {
        TypeInner::Scalar(scalar) | TypeInner::Atomic(scalar) => Some(*scalar),
        // A pair of f32, as the df64 tier has it.
        TypeInner::Vector { size: naga::VectorSize::Bi, scalar } => {
            Some(Scalar { width: 2 * scalar.width, ..*scalar })
        }
        _ => None,
    }
}

/// Fields follow each other, each aligned to its own size of 4 or 8 bytes, with the struct's size a multiple of the
/// largest: so a host that packs by the same rule agrees.
fn assert_packed(module: &Module, name: &str, real_size: usize) {
    let (fields, stride) = fields(module, name);
    let mut end = 0_usize;
    for field in &fields {
        assert_eq!(field.size, if field.real { real_size } else { 4 }, "{name}.{}", field.name);
        assert_eq!(field.offset, end.next_multiple_of(field.size), "{name}.{}", field.name);
        end = field.offset + field.size;
    }
    let largest = fields.iter().map(|field| field.size).max().unwrap();
    assert_eq!(stride, end.next_multiple_of(largest), "size of {name}");
}

fn names(module: &Module, name: &str) -> Vec<String> {
    fields(module, name).0.into_iter().map(|field| field.name).collect()
}

fn tiers_in_tables() -> [Tier; 2] {
    [Precision::F32, Precision::F64].map(|precision| Tier { precision, native: false, baked: false })
}

#[test]
fn structs_shared_with_the_host_are_packed_scalars() {
    for tier in tiers_in_tables() {
        let program = everything_in_buffers().program(tier);
        let structs =
            ["Range", "Source", "Event", "SurfaceRow", "DetectorRow", "PrimitiveRow", "QueueCounts"];
        for name in structs {
            assert_packed(&program.module, name, program.real_size());
        }
    }
}

/// The numbers of a buffer.
fn reals(program: &Program, variable: &str) -> Vec<f64> {
    let number = binding(program, variable);
    let (_, bytes) = program.buffers.iter().find(|(of, _)| *of == number).unwrap();
    let size = program.real_size();
    let field = |offset| Field { name: String::new(), offset, size, real: true };
    (0..bytes.len()).step_by(size).map(|offset| read(bytes, &field(offset))).collect()
}

/// The words of a buffer.
fn words(program: &Program, variable: &str) -> Vec<u32> {
    let number = binding(program, variable);
    let (_, bytes) = program.buffers.iter().find(|(of, _)| *of == number).unwrap();
    bytes.chunks_exact(4).map(|word| u32::from_le_bytes(word.try_into().unwrap())).collect()
}

/// A node of a tree as geometry/boxes.wgsl reads it: the boxes of its children, and the children.
struct Node {
    boxes: Vec<[[f64; 3]; 2]>,
    inner: Vec<usize>,
    items: Vec<usize>,
}

fn node(rows: &[u32], i: usize) -> Node {
    let row = |k: usize| <[u32; 4]>::try_from(&rows[12 * i + 4 * k..12 * i + 4 * k + 4]).unwrap();
    let [grid, lower, upper] = [0, 1, 2].map(row);
    let [num_inner, num] = [24, 28].map(|shift| (grid[3] >> shift & 0xF) as usize);
    let cell = |axis: usize| f64::from(f32::from_bits((grid[3] >> (8 * axis) & 0xFF) << 23));
    let corner = |bytes: [u32; 4], k: usize| {
        [0, 1, 2].map(|axis| {
            let cells = bytes[axis] >> (8 * k) & 0xFF;
            f64::from(f32::from_bits(grid[axis])) + f64::from(cells) * cell(axis)
        })
    };
    Node {
        boxes: (0..num).map(|k| [corner(lower, k), corner(upper, k)]).collect(),
        inner: (0..num_inner).map(|k| lower[3] as usize + k).collect(),
        items: (num_inner..num).map(|k| upper[3].wrapping_add(k as u32) as usize).collect(),
    }
}

/// The numbers of triangles: after the trees, or in a buffer of their own.
fn triangle_rows(program: &Program, trees: &[u32]) -> Vec<f64> {
    let Some((_, after)) = program.wgsl.split_once("const FIRST_TRIANGLE: u32 = ") else {
        return reals(program, "mesh_rows");
    };
    let first: usize = after.split_once('u').unwrap().0.parse().unwrap();
    trees[4 * first..].iter().map(|&bits| f64::from(f32::from_bits(bits))).collect()
}

/// From the root of the one mesh: every triangle lies in one leaf, strictly within its boxes, beside its unit normal.
#[test]
fn rows_of_a_mesh_are_where_the_shader_looks() {
    for tier in tiers_in_tables() {
        let variant = everything();
        let program = variant.program(tier);
        let nodes = words(&program, "tree_rows");
        let rows = triangle_rows(&program, &nodes);
        let row = |i: usize| <[f64; 4]>::try_from(&rows[4 * i..4 * i + 4]).unwrap();
        let mut corners = Vec::new();
        let mut waiting = vec![(0, [[f64::NEG_INFINITY; 3], [f64::INFINITY; 3]])];
        while let Some((i, within)) = waiting.pop() {
            let node = node(&nodes, i);
            let holds = |[low, high]: [[f64; 3]; 2], corner: [f64; 4]| {
                (0..3).all(|axis| low[axis] < corner[axis] && corner[axis] < high[axis])
            };
            waiting.extend(node.inner.iter().copied().zip(node.boxes.iter().copied()));
            for (&item, &of_item) in node.items.iter().zip(&node.boxes[node.inner.len()..]) {
                let triangle = 3 * item;
                let normal = [0, 1, 2].map(|i| row(triangle + i)[3]);
                assert!(
                    (normal.map(|x| x * x).iter().sum::<f64>() - 1.0).abs() < 1e-6,
                    "{tier:?}: {normal:?}"
                );
                for corner in [0, 1, 2].map(|i| row(triangle + i)) {
                    assert!(holds(of_item, corner) && holds(within, corner), "{tier:?}");
                    corners.push([corner[0], corner[1], corner[2]]);
                }
            }
        }
        let mesh = &variant.ir.meshes[0];
        let mut expected: Vec<[f64; 3]> =
            mesh.faces.iter().flat_map(|face| mesh.corners(*face)).map(|v| v.to_array()).collect();
        expected.sort_by(|a, b| a.partial_cmp(b).unwrap());
        corners.sort_by(|a, b| a.partial_cmp(b).unwrap());
        assert_eq!(corners, expected, "{tier:?}");
    }
}

/// A state of 80 bytes or less a ray: what the queues cost.
#[test]
fn a_queued_ray_is_small() {
    for tier in tiers_in_tables() {
        let program = everything().program(tier);
        assert!(StructLayout::of(&program.module, "RayInQueue").unwrap().stride <= 80, "{tier:?}");
    }
}

#[test]
fn both_shaders_have_the_same_queue_counts() {
    let advance = naga::front::wgsl::parse_str(&nsq_gpu::program::wgsl::compose::advance()).unwrap();
    let program = everything().program(tiers_in_tables()[0]);
    let trace = &program.module;
    assert_eq!(fields(&advance, "QueueCounts"), fields(trace, "QueueCounts"));
    // The host reads the number of rows from byte 8 on, whether loops were cut from byte 12 on.
    assert_eq!(names(trace, "QueueCounts"), ["incoming", "outgoing", "events", "cut"]);
    assert_eq!(StructLayout::of(trace, "QueueCounts").unwrap().stride, 16);
}

/// A number of the bytes of a struct.
fn read(bytes: &[u8], field: &Field) -> f64 {
    let place = &bytes[field.offset..field.offset + field.size];
    match (field.real, field.size) {
        (false, _) => f64::from(u32::from_le_bytes(place.try_into().unwrap())),
        (true, 4) => f64::from(f32::from_le_bytes(place.try_into().unwrap())),
        (true, _) => f64::from_le_bytes(place.try_into().unwrap()),
    }
}

/// What [`Variant::program`] traces with.
const SEED: u64 = 0;

/// Every field of the range is written, with what it is named for.
#[test]
fn host_writes_every_field_of_a_range() {
    for tier in tiers_in_tables() {
        let (ir, program) = range_scene(tier);
        let source = ir.sources.len() - 1;
        let range = RayRange { first: (7 << 32) + 5, count: 11, source, log_stride: 13, reached: 5 };
        let bytes = program.range_bytes(&range).unwrap();
        assert_eq!(written(&program, "Range", &bytes), expected_range(source), "{tier:?}");
        let written = written(&program, "Source", &program.source_uniforms[source]);
        assert_eq!(written, expected_source(&ir, &program, source), "{tier:?}");
    }
}

/// The fields of a uniform, as its shader reads them.
fn written(program: &Program, name: &str, bytes: &[u8]) -> Vec<(String, f64)> {
    let (fields, stride) = fields(&program.module, name);
    assert_eq!(bytes.len(), stride, "{name}");
    fields.iter().map(|field| (field.name.clone(), read(bytes, field))).collect()
}

/// Two sources; the last one's numbers are all different and none is zero.
fn range_scene(tier: Tier) -> (SceneIr, Program) {
    let mut variant = Variant::default();
    Choice::Polychromatic.apply(&mut variant);
    Choice::Source(nsq_gpu::program::SourceFunction::ExtendedRectangle).apply(&mut variant);
    let lamp = variant.ir.sources.last_mut().unwrap();
    lamp.medium = 1;
    lamp.frame.origin = glam::DVec3::new(2.0, 4.0, 8.0);
    // A table of distinct numbers that f32 holds, to see each in its place.
    lamp.frame.rotation =
        glam::DMat3::from_cols_array(&[0.5, 0.25, 0.125, 0.75, 0.375, 0.875, -0.5, -0.25, -0.125]);
    let program = variant.program(tier);
    (variant.ir, program)
}

fn expected_range(source: usize) -> Vec<(String, f64)> {
    let [seed_lo, seed_hi, ..] = nsq_gpu::program::layout::rng::step_table(Sampler::Pcg, SEED, 1)[0];
    let expected = [
        ("first_lo", 5.0),
        ("first_hi", 7.0),
        ("count", 11.0),
        ("source", source as f64),
        ("seed_lo", f64::from(seed_lo)),
        ("seed_hi", f64::from(seed_hi)),
        ("log_stride", 13.0),
        ("reached", 5.0),
    ];
    expected.into_iter().map(|(name, value)| (name.to_string(), value)).collect()
}

fn expected_source(ir: &SceneIr, program: &Program, source: usize) -> Vec<(String, f64)> {
    let lamp = &ir.sources[source];
    let origin = lamp.frame.origin - program.centre;
    let s = (0.5_f64 / 2.0).sin();
    let height = 2.0 * s * s;
    let height = if program.options.precision == Precision::F32 { f64::from(height as f32) } else { height };
    let mut expected = vec![
        ("kind", f64::from(nsq_gpu::program::SourceFunction::ExtendedRectangle as u32)),
        ("medium", 1.0),
        ("spectrum_first", 2.0),
        ("spectrum_count", 2.0),
        ("weight", 1.25),
        ("origin_x", origin.x),
        ("origin_y", origin.y),
        ("origin_z", origin.z),
    ];
    let columns = ["xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz"];
    expected.extend(columns.into_iter().zip(lamp.frame.rotation.to_cols_array()));
    expected.extend([("p0", 3.0), ("p1", 4.0), ("p2", height)]);
    expected.into_iter().map(|(name, value)| (name.to_string(), value)).collect()
}

/// What the host reads of a row.
#[test]
fn rows_have_the_fields_that_the_host_reads() {
    let mut expected = vec!["kind", "subject", "index", "bounce", "wavelength", "weight"];
    expected.extend(["position_x", "position_y", "position_z", "direction_x", "direction_y", "direction_z"]);
    for tier in Tier::all() {
        let mut variant = Variant::default();
        Choice::Paths(PathSampling::All).apply(&mut variant);
        assert_eq!(names(&variant.program(tier).module, "Event"), expected, "{tier:?}");
    }
}

/// A column of a table as its shader reads it.
pub fn column(program: &Program, table: &str, binding: u32, name: &str) -> Vec<f64> {
    let (fields, stride) = fields(&program.module, table);
    let field =
        fields.iter().find(|field| field.name == name).unwrap_or_else(|| panic!("{table} has no {name}"));
    let (_, bytes) = program.buffers.iter().find(|(number, _)| *number == binding).unwrap();
    bytes.chunks_exact(stride).map(|row| read(row, field)).collect()
}

/// The binding of a variable.
pub fn binding(program: &Program, variable: &str) -> u32 {
    let found = program.module.global_variables.iter().find(|(_, v)| v.name.as_deref() == Some(variable));
    found.unwrap_or_else(|| panic!("no variable {variable}")).1.binding.unwrap().binding
}

#[test]
fn tables_hold_the_scene_where_the_shaders_look() {
    for tier in tiers_in_tables() {
        let mut variant = everything_in_buffers();
        // What all rows share is a constant, and in no table.
        for (i, surface) in variant.ir.surfaces.iter_mut().enumerate() {
            surface.frame.origin.z += 0.5 * i as f64;
            surface.back = i % 2;
        }
        let (ir, program) = (&variant.ir, variant.program(tier));
        let of = |table, variable, name| column(&program, table, binding(&program, variable), name);
        let origins: Vec<f64> = ir.surfaces.iter().map(|s| s.frame.origin.z - program.centre.z).collect();
        assert_eq!(of("SurfaceRow", "surface_table", "origin_z"), origins, "{tier:?}");
        let backs: Vec<f64> = ir.surfaces.iter().map(|s| s.back as f64).collect();
        assert_eq!(of("SurfaceRow", "surface_table", "back"), backs, "{tier:?}");
        let cells: Vec<f64> = program.cells.detectors.iter().map(|&cell| f64::from(cell)).collect();
        assert_eq!(of("DetectorRow", "detector_table", "cell"), cells, "{tier:?}");
        let absorb: Vec<f64> = ir.detectors.iter().map(|s| f64::from(u8::from(s.absorb))).collect();
        assert_eq!(of("DetectorRow", "detector_table", "absorb"), absorb, "{tier:?}");
        let shapes: Vec<f64> =
            nsq_gpu::model::primitives::primitives(ir).iter().map(|(_, shape)| code_of(shape)).collect();
        assert_eq!(of("PrimitiveRow", "primitive_table", "shape"), shapes, "{tier:?}");
    }
}

fn code_of(shape: &Shape) -> f64 {
    f64::from(ShapeKind::of(shape) as u32)
}

#[test]
fn tables_hold_no_detectors_that_stand_apart_from_the_tree() {
    for tier in tiers_in_tables() {
        let mut variant = everything_in_buffers();
        variant.hot_path = None;
        variant.ir.detectors.truncate(8);
        let program = variant.program(tier);
        let shapes: Vec<f64> = variant.ir.surfaces.iter().map(|surface| code_of(&surface.shape)).collect();
        let codes = column(&program, "PrimitiveRow", binding(&program, "primitive_table"), "shape");
        assert_eq!(codes, shapes, "{tier:?}");
    }
}

/// A number as `primitive_at` puts it together from the words of a primitive's texels.
fn from_texels(expression: &str, words: &[u32]) -> f64 {
    let named: Vec<u32> = expression
        .split("texel_")
        .skip(1)
        .map(|rest| {
            let (texel, component) = rest.split_once('.').unwrap();
            words[4 * texel.parse::<usize>().unwrap() + "xyzw".find(&component[..1]).unwrap()]
        })
        .collect();
    match (expression.split_once("texel_").unwrap().0, &named[..]) {
        ("", &[word]) => f64::from(word),
        ("bitcast<f32>(", &[word]) => f64::from(f32::from_bits(word)),
        ("bitcast<f64>(u64(", &[low, high]) => f64::from_bits(u64::from(low) | u64::from(high) << 32),
        other => panic!("{other:?} in {expression}"),
    }
}

#[test]
fn texels_hold_the_primitives_where_the_shaders_look() {
    for tier in [(Precision::F32, false), (Precision::F64, true)].map(|(precision, native)| Tier {
        precision,
        native,
        baked: false,
    }) {
        let mut variant = everything();
        for (i, surface) in variant.ir.surfaces.iter_mut().enumerate() {
            surface.frame.origin.z += 0.5 * i as f64;
        }
        let program = variant.program(tier);
        let of = |name: &str| constant(&program.module, name) as usize;
        let (first, each, num) = (of("FIRST_PRIMITIVE"), of("PRIMITIVE_ROWS"), of("TREE_PRIMITIVES"));
        let rows = words(&program, "tree_rows");
        assert_eq!(rows.len(), 4 * (first + each * num), "{tier:?}");
        let (_, body) = program.wgsl.split_once("fn primitive_at(").unwrap();
        let (_, values) = body.split_once("return Primitive(\n").unwrap();
        let values: Vec<&str> =
            values.lines().take_while(|line| line.trim() != ");").map(str::trim).collect();
        let fields = names(&program.module, "Primitive");
        assert_eq!(values.len(), fields.len(), "{values:?}");
        let expression = |name: &str| values[fields.iter().position(|field| field == name).unwrap()];
        let primitives = nsq_gpu::model::primitives::primitives(&variant.ir);
        let mut numbers = Vec::new();
        for place in 0..num {
            let texels = &rows[4 * (first + each * place)..][..4 * each];
            let number = from_texels(expression("number"), texels) as usize;
            let (frame, shape) = &primitives[number];
            let kind = from_texels(expression("shape"), texels);
            assert_eq!(kind, code_of(shape), "shape of {number}, {tier:?}");
            let z = tier.precision.nearest(frame.origin.z - program.centre.z);
            assert_eq!(from_texels(expression("origin_z"), texels), z, "place of {number}, {tier:?}");
            numbers.push(number);
        }
        numbers.sort_unstable();
        assert_eq!(numbers, (0..num).collect::<Vec<_>>(), "{tier:?}");
    }
}

/// Every read-only buffer of group 0 that a shader declares is one that the host fills, and no other.
#[test]
fn host_fills_the_buffers_that_shaders_declare() {
    // Of the trace, not of the program: range, draws, rows, source, the deposit log, the failed rays; and the sums.
    let traced = [
        bindings::RANGE,
        bindings::RNG_TABLE,
        bindings::EVENTS,
        bindings::SOURCE,
        bindings::LOG,
        bindings::LISTED_IDS,
        bindings::PATHS,
        bindings::PATHS_HEAD,
    ];
    for tier in crate::files::in_turn(Tier::all()) {
        for (name, variant) in
            Choice::all().into_iter().map(Variant::of_choice).chain([("all".into(), everything())])
        {
            let program = variant.program(tier);
            let bindings =
                program.module.global_variables.iter().filter_map(|(_, variable)| variable.binding);
            let parts: Vec<u32> = program.sums.all().flat_map(|sums| sums.bindings.clone()).collect();
            let mut declared: Vec<u32> = bindings
                .filter(|b| b.group == 0 && !traced.contains(&b.binding) && !parts.contains(&b.binding))
                .map(|b| b.binding)
                .collect();
            let mut filled: Vec<u32> = program.buffers.iter().map(|(number, _)| *number).collect();
            declared.sort_unstable();
            filled.sort_unstable();
            assert_eq!(declared, filled, "{name}, {tier:?}");
        }
    }
}
