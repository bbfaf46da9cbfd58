// Maps of the working scale and its centre view, 0 where it is not known, in one array: a stage may bind eight.

@group(0) @binding(0) var<storage, read> small: array<f32>;  // (h, w, 3)
@group(0) @binding(1) var<storage, read> disparity: array<u32>;  // (h, w), bits of float32
@group(0) @binding(2) var<storage, read> sigma: array<u32>;
@group(0) @binding(3) var<storage, read> confidence: array<u32>;
@group(0) @binding(4) var<storage, read_write> coarse: array<u32>;  // (4, h, w)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= pixels) { return; }
    let rgb = vec3f(small[3u * i], small[3u * i + 1u], small[3u * i + 2u]);
    var value = 0.0;
    if (is_finite(rgb.x)) { value = dot(vec3f(guide_rgb[0], guide_rgb[1], guide_rgb[2]), rgb); }
    coarse[i] = disparity[i];
    coarse[pixels + i] = sigma[i];
    coarse[2u * pixels + i] = confidence[i];
    coarse[3u * pixels + i] = bitcast<u32>(value);
}
