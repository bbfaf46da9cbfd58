// Views, guide and mask, every second column of the picture behind OpenCV's pyramid filter (1, 4, 6, 4, 1) / 16.
// Unusable pixels count 0, which is the mean of the views. The guide at full resolution goes out beside them. One
// invocation takes four neighbours, whose pixels overlap.

@group(0) @binding(0) var<storage, read> image: array<f32>;  // (H, W, 3)
@group(0) @binding(1) var<storage, read> stats: array<f32>;
@group(0) @binding(2) var<storage, read_write> planes: array<f32>;  // (K + 2, H, w): views, guide, mask
@group(0) @binding(3) var<storage, read_write> full_guide: array<f32>;  // (H, W)

struct Seen {
    views: vec3f,
    others: vec2f,  // guide, usable share
}

fn seen(x: i32, y: u32) -> Seen {
    let found = pixel(mirrored(x, width), y);
    return Seen(found.usable * found.views, vec2f(found.guide, found.usable));
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let each = (half_width + 3u) / 4u;  // invocations of a row
    if (i >= each * height) { return; }
    let first = 4u * (i % each);
    let y = i / each;
    let plane = half_width * height;
    var a = seen(2i * i32(first) - 2i, y);
    var b = seen(2i * i32(first) - 1i, y);
    var c = seen(2i * i32(first), y);
    for (var x = first; x < min(first + 4u, half_width); x++) {
        let d = seen(2i * i32(x) + 1i, y);
        let e = seen(2i * i32(x) + 2i, y);
        let views = 0.0625 * a.views + 0.25 * b.views + 0.375 * c.views + 0.25 * d.views + 0.0625 * e.views;
        let others = 0.0625 * a.others + 0.25 * b.others + 0.375 * c.others + 0.25 * d.others + 0.0625 * e.others;
        let at = y * half_width + x;
        for (var k = 0u; k < view_count; k++) { planes[k * plane + at] = views[k]; }
        planes[view_count * plane + at] = others.x;
        planes[(view_count + 1u) * plane + at] = others.y;
        full_guide[y * width + 2u * x] = c.others.x;
        if (2u * x + 1u < width) { full_guide[y * width + 2u * x + 1u] = d.others.x; }
        a = c;
        b = d;
        c = e;
    }
}
