// Depth buffers of the channels' views: the nearest of the pixels that fall on one. They are 0 before.

@group(0) @binding(0) var<storage, read> filled: array<f32>;  // (H, W)
@group(0) @binding(1) var<storage, read_write> nearest: array<atomic<u32>>;  // (3, H, W): `nearness`

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    for (var k = 0u; k < 3u; k++) {
        if (is_still(k)) { continue; }
        let place = place_in(k, i % width, i / width, filled[i]);
        if (place >= 0i) { atomicMax(&nearest[k * width * height + u32(place)], nearness(filled[i])); }
    }
}
