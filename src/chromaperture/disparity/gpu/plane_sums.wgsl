// What the pixels of a plane say of it: how many there are and how many of them are certain, of those away from steps
// and of all, and how far the surface before lay from the plane. A workgroup has one plane and a part of the pixels.

@group(0) @binding(0) var<storage, read> choice: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read> beside: array<u32>;  // (h, w)
@group(0) @binding(2) var<storage, read> sigma: array<f32>;  // (h, w), layers
@group(0) @binding(3) var<storage, read> there: array<f32>;  // (h, w): layer of the plane
@group(0) @binding(4) var<storage, read> first: array<f32>;  // (h, w): layer of the surface before
@group(0) @binding(5) var<storage, read> plane_count: array<u32>;
@group(0) @binding(6) var<storage, read_write> sums: array<vec4f>;  // (planes, parts, 2)

var<workgroup> counts: array<vec4f, 64>;  // away, of which certain; all, of which certain
var<workgroup> others: array<vec4f, 64>;  // squared distances of the surface before; pixels where it contradicts the plane

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    if (group.x >= plane_count[0]) { return; }
    let each = (width * height + parts - 1u) / parts;
    let start = group.y * each;
    var count = vec4f();
    var other = vec4f();
    for (var i = start + local; i < min(start + each, width * height); i += 64u) {
        if (choice[i] == group.x) {
            let certain = select(0.0, 1.0, sigma[i] < known_within);
            let away = select(1.0, 0.0, beside[i] == 1u);
            let distance = clamp(first[i] - there[i], -most_apart, most_apart);
            count += vec4f(away, away * certain, 1.0, certain);
            other += vec4f(distance * distance, select(0.0, 1.0, abs(distance) > apart), 0.0, 0.0);
        }
    }
    counts[local] = count;
    others[local] = other;
    workgroupBarrier();
    for (var half = 32u; half > 0u; half /= 2u) {
        if (local < half) {
            counts[local] += counts[local + half];
            others[local] += others[local + half];
        }
        workgroupBarrier();
    }
    if (local == 0u) {
        sums[2u * (group.x * parts + group.y)] = counts[0];
        sums[2u * (group.x * parts + group.y) + 1u] = others[0];
    }
}
