// The median of the layers within `reach` pixels, `accurate.median_filtered`; beyond the border lies what is at it. Of
// values that are alike the first counts as the smaller, so that one value alone is in the middle.

@group(0) @binding(0) var<storage, read> before: array<vec4f>;  // (h, w): layer first
@group(0) @binding(1) var<storage, read_write> after: array<vec4f>;  // (h, w): its median, and what else there was

const size = 2u * reach + 1u;
const count = size * size;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let pixel = invocation(group, groups, local);
    if (pixel >= width * height) { return; }
    let last = vec2i(i32(width), i32(height)) - 1;
    let corner = vec2i(i32(pixel % width), i32(pixel / width)) - i32(reach);
    var values: array<f32, count>;
    for (var k = 0u; k < count; k++) {
        let place = clamp(corner + vec2i(i32(k % size), i32(k / size)), vec2i(0), last);
        values[k] = before[u32(place.y) * width + u32(place.x)].x;
    }
    var found = before[pixel];
    for (var k = 0u; k < count; k++) {
        var smaller = 0u;
        for (var other = 0u; other < count; other++) {
            let alike = values[other] == values[k] && other < k;
            smaller += u32(values[other] < values[k] || alike);
        }
        if (smaller == count / 2u) { found.x = values[k]; }
    }
    after[pixel] = found;
}
