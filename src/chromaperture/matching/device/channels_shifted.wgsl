// Each channel shifted back, and which channels see the pixel; `sample` decides by how much and by which filter.

@group(0) @binding(0) var<storage, read> image: array<f32>;  // (H, W, 3)
@group(0) @binding(1) var<storage, read> filled: array<f32>;  // (H, W)
@group(0) @binding(2) var<storage, read> nearest: array<u32>;  // (3, H, W): `nearness`
@group(0) @binding(3) var<storage, read_write> shifted: array<f32>;  // (H, W, 3)
@group(0) @binding(4) var<storage, read_write> visible: array<u32>;  // (H, W): a bit a channel

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let x = i % width;
    let y = i / width;
    let disparity = filled[i];
    var seen = 0u;
    for (var k = 0u; k < 3u; k++) {
        shifted[3u * i + k] = sample(x, y, k, disparity);
        if (is_still(k)) {
            seen |= 1u << k;
            continue;
        }
        let place = place_in(k, x, y, disparity);
        if (place < 0i) { continue; }
        if (disparity_of(nearest[k * width * height + u32(place)]) > disparity - occlusion_px) { seen |= 1u << k; }
    }
    visible[i] = seen;
}
