// Crossings of triangles in f32. Twin of edges.exact.wgsl.
//
// A ray that has just met a facet stands on it only within rounding. The ray may lie beside the facet's plane, and near
// an edge even beyond the next wall. In a guide of 1 x 1 x 1000 mm, 18 of 100 W leaked out there.
//
// Two rules close the leak, for a ray that leaves a facet to one side. The ray meets the facets that bound that side
// even where it stands beyond them, or passes their edges, by at most EDGE_SLACK. And the ray meets no facet from
// behind within EDGE_SLACK of the plane that it leaves: such a facet is the same wall.

// The facet that the ray leaves: a corner, and the normal on the side to which the ray goes.
struct LeftFacet {
    leaves: bool,
    corner: vec3<real>,
    normal: vec3<real>,
    // 1 where the facet's own normal points to that side, else -1.
    side: real,
}

var<private> left_facet: LeftFacet;

fn leave_facet(ray: MeshRay, leaving: bool) {
    left_facet.leaves = leaving;
    if leaving {
        let n = normal_in_rows(arrived_triangle);
        let side = choose(-1.0, 1.0, dot(n, ray.direction) > 0.0);
        left_facet = LeftFacet(true, mesh_row(arrived_triangle).xyz, side * n, side);
    }
}

fn normal_in_rows(triangle: u32) -> vec3<real> {
    return vec3<real>(mesh_row(triangle).w, mesh_row(triangle + 1u).w, mesh_row(triangle + 2u).w);
}

// The longer side of the rectangle around three corners, as the ray sees them.
fn seen_extent(a: vec3<real>, b: vec3<real>, c: vec3<real>) -> real {
    let extent = max(a.xy, max(b.xy, c.xy)) - min(a.xy, min(b.xy, c.xy));
    return max(extent.x, extent.y);
}

// How far a corner lies above the plane that the ray leaves, on the ray's side.
fn rise_of(corner: vec3<real>) -> real {
    return dot(corner - left_facet.corner, left_facet.normal);
}

// Where the ray crosses a triangle, or MISS. Edges belong to the triangle.
fn triangle_crossing(ray: MeshRay, triangle: u32) -> real {
    let rows = array<vec4<real>, 3>(mesh_row(triangle), mesh_row(triangle + 1u), mesh_row(triangle + 2u));
    let s = seen_triangle(ray, rows[0].xyz, rows[1].xyz, rows[2].xyz);
    let area = s.u + s.v + s.w;
    let n = vec3<real>(rows[0].w, rows[1].w, rows[2].w);
    // The distance to the plane, not the corners weighted by areas. Those weights are differences of large products,
    // which would move the crossing along the ray.
    let slope_of_facet = dot(n, ray.direction);
    let t = dot(n, rows[0].xyz - ray.base) / slope_of_facet;
    let crosses = is_crossed(s) && slope_of_facet != 0.0;
    if !left_facet.leaves {
        return select(MISS, t, crosses);
    }
    let ahead = t - ray.start;
    let slope = left_facet.side * slope_of_facet;
    let bounds_side = slope < 0.0;
    let is_same_wall = !bounds_side && ahead * dot(ray.direction, left_facet.normal) <= EDGE_SLACK;
    if crosses && ahead > 0.0 && !is_same_wall {
        return t;
    }
    let room = EDGE_SLACK * seen_extent(s.a, s.b, s.c);
    let inner = choose(-1.0, 1.0, area > 0.0) * min(s.u, min(s.v, s.w));
    let outer = choose(-1.0, 1.0, area > 0.0) * max(s.u, max(s.v, s.w));
    let is_near = min(inner, outer) >= -2.0 * room && abs(area) > 4.0 * room;
    let stands_beyond = ahead > 0.0 || ahead * slope <= EDGE_SLACK;
    let rises = max(rise_of(rows[0].xyz), max(rise_of(rows[1].xyz), rise_of(rows[2].xyz))) > EDGE_SLACK;
    let first_ahead = ray.start + 2.4e-7 * abs(ray.start) + 1e-30;
    return select(MISS, max(t, first_ahead), bounds_side && is_near && stands_beyond && rises);
}
