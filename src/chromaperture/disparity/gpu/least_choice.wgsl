// The choice of least belief of every block, the first of several.

@group(0) @binding(0) var<storage, read> beliefs: array<f32>;  // (pixels, planes)
@group(0) @binding(1) var<storage, read> plane_count: array<u32>;
@group(0) @binding(2) var<storage, read_write> choice: array<u32>;  // (pixels,)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let pixel = invocation(group, groups, local);
    if (pixel >= pixels) { return; }
    let number = plane_count[0];
    var best = 0u;
    for (var k = 1u; k < number; k++) {
        if (beliefs[pixel * number + k] < beliefs[pixel * number + best]) { best = k; }
    }
    choice[pixel] = best;
}
