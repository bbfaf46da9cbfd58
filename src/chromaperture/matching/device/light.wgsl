// Mean light of the usable pixels, and how many there are: what views are centred on and unknown pixels replaced by.
// This stage sums parts of the picture, `light_sum.wgsl` the parts.

@group(0) @binding(0) var<storage, read> image: array<f32>;  // (H, W, 3)
@group(0) @binding(1) var<storage, read_write> parts: array<f32>;  // (groups, 4)

@compute @workgroup_size(256)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    var own = vec4f();
    for (var i = group.x * 256u + local; i < pixels; i += part_count * 256u) {
        let rgb = vec3f(image[3u * i], image[3u * i + 1u], image[3u * i + 2u]);
        if (is_finite(rgb.x) && is_finite(rgb.y) && is_finite(rgb.z) && max(max(rgb.x, rgb.y), rgb.z) < saturation) {
            own += vec4f(rgb, 1.0);
        }
    }
    let total = summed(own, local);
    if (local == 0u) {
        for (var c = 0u; c < 4u; c++) { parts[4u * group.x + c] = total[c]; }
    }
}
