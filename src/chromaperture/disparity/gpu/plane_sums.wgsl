// At how many of a plane's pixels the surface before contradicts it, and how many there are. A workgroup has one plane and
// a part of the pixels.

@group(0) @binding(0) var<storage, read> choice: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read> there: array<f32>;  // (h, w): layer of the plane
@group(0) @binding(2) var<storage, read> first: array<f32>;  // (h, w): layer of the surface before
@group(0) @binding(3) var<storage, read> plane_count: array<u32>;
@group(0) @binding(4) var<storage, read_write> sums: array<vec2f>;  // (planes, parts)

var<workgroup> of_lane: array<vec2f, 64>;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    if (group.x >= plane_count[0]) { return; }
    let each = (width * height + parts - 1u) / parts;
    let start = group.y * each;
    var sum = vec2f();
    for (var i = start + local; i < min(start + each, width * height); i += 64u) {
        if (choice[i] == group.x) { sum += vec2f(select(0.0, 1.0, abs(first[i] - there[i]) > apart), 1.0); }
    }
    of_lane[local] = sum;
    workgroupBarrier();
    for (var half = 32u; half > 0u; half /= 2u) {
        if (local < half) { of_lane[local] += of_lane[local + half]; }
        workgroupBarrier();
    }
    if (local == 0u) { sums[group.x * parts + group.y] = of_lane[0]; }
}
