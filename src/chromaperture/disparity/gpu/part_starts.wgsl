// Where the points of every plane's part start: those of its core, or all blocks where the core is small. One workgroup;
// an invocation has planes that follow one another. A single plane is no part: it is left as it is.

@group(0) @binding(0) var<storage, read> counts: array<vec2u>;  // (capacity,): all blocks, core
@group(0) @binding(1) var<storage, read> plane_count: array<u32>;
@group(0) @binding(2) var<storage, read_write> segments: array<vec4u>;  // (capacity,): see `part_of_points.wgsl`

var<workgroup> sums: array<u32, 64>;

fn points_of(k: u32) -> u32 {
    return select(counts[k].x, counts[k].y, f32(counts[k].y) >= least_core * f32(counts[k].x));
}

@compute @workgroup_size(64)
fn main(@builtin(local_invocation_index) local: u32) {
    let each = (capacity + 63u) / 64u;
    let first = local * each;
    let end = min(first + each, capacity);
    let is_one = plane_count[0] < 2u;
    var own = 0u;
    for (var k = first; k < end; k++) { own += points_of(k); }
    sums[local] = own;
    workgroupBarrier();
    var start = 0u;
    for (var other = 0u; other < local; other++) { start += sums[other]; }
    for (var k = first; k < end; k++) {
        let number = select(points_of(k), 0u, is_one);
        segments[k] = vec4u(start, number, 0u, k);
        start += number;
    }
}
