// Largest and smallest value along one axis within `reach` pixels, of maps whose two values are these, or one in x where
// `of_one`; pixels beyond the border do not count.

@group(0) @binding(0) var<storage, read> before: array<vec4f>;  // (h, w): both in x, or largest and smallest in xy
@group(0) @binding(1) var<storage, read_write> after: array<vec4f>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let pixel = invocation(group, groups, local);
    if (pixel >= width * height) { return; }
    let place = select(pixel / width, pixel % width, along_x);
    let last = select(height, width, along_x) - 1u;
    let stride = select(width, 1u, along_x);
    var found = vec2f(-1.0e30, 1.0e30);
    for (var k = max(place, reach) - reach; k <= min(place + reach, last); k++) {
        let here = before[pixel + k * stride - place * stride];
        found = vec2f(max(found.x, here.x), min(found.y, select(here.y, here.x, of_one)));
    }
    after[pixel] = vec4f(found, 0.0, 0.0);
}
