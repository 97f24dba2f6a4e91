// Apertures that are no disk about the axis. The aperture of a surface stands in the buffer of tables, at `first`. The
// number of numbers comes first, then the parts of the aperture (model::shapes::Aperture::numbers). For example, a
// union stands behind the two parts that it joins. Where `first` is negative, or no number follows, the surface has no
// such aperture. Twin of clip.none.wgsl.

// What stands in the table. An ellipse and a rectangle have a middle and the inverses of the semi-axes, and a polygon
// has its corners. The other codes make one part of the last two parts, or of the last one.
const CLIP_ELLIPSE: u32 = 0u;
const CLIP_RECTANGLE: u32 = 1u;
const CLIP_POLYGON: u32 = 2u;
const CLIP_UNION: u32 = 3u;
const CLIP_INTERSECTION: u32 = 4u;
const CLIP_DIFFERENCE: u32 = 5u;

fn clip_holds(p: vec3<real>, first: real) -> bool {
    if first < 0.0 {
        return true;
    }
    var at = u32(first) + 1u;
    let end = at + u32(tables[at - 1u]);
    // One bit for each part that is not yet used, the last one lowest.
    var parts = select(0u, 1u, at == end);
    while at < end {
        let code = u32(tables[at]);
        at += 1u;
        if code <= CLIP_RECTANGLE {
            let along = abs(p.x - tables[at]) * tables[at + 2u];
            let across = abs(p.y - tables[at + 1u]) * tables[at + 3u];
            let is_inside = select(along * along + across * across, max(along, across), code == CLIP_RECTANGLE) <= 1.0;
            parts = (parts << 1u) | select(0u, 1u, is_inside);
            at += 4u;
        } else if code == CLIP_POLYGON {
            let count = u32(tables[at]);
            parts = (parts << 1u) | clip_polygon(p, at + 1u, count);
            at += 1u + 2u * count;
        } else {
            let last = parts & 1u;
            let before = (parts >> 1u) & 1u;
            if code > CLIP_DIFFERENCE {
                parts ^= 1u;
            } else {
                let either = select(before & last, before | last, code == CLIP_UNION);
                let made = select(either, before & (1u - last), code == CLIP_DIFFERENCE);
                parts = ((parts >> 2u) << 1u) | made;
            }
        }
    }
    return (parts & 1u) == 1u;
}

// 1 if an odd number of sides crosses the line from a point towards +x.
fn clip_polygon(p: vec3<real>, first: u32, count: u32) -> u32 {
    var inside = 0u;
    var from_x = tables[first + 2u * count - 2u];
    var from_y = tables[first + 2u * count - 1u];
    var i = 0u;
    while i < count {
        let to_x = tables[first + 2u * i];
        let to_y = tables[first + 2u * i + 1u];
        if (from_y > p.y) != (to_y > p.y) {
            let x = (to_x - from_x) * (p.y - from_y) / (to_y - from_y) + from_x;
            inside ^= select(0u, 1u, p.x < x);
        }
        from_x = to_x;
        from_y = to_y;
        i += 1u;
    }
    return inside;
}
