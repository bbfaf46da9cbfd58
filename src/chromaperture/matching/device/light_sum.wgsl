// Sums the parts that `light.wgsl` left up, to the first numbers of `stats`.

@group(0) @binding(0) var<storage, read> parts: array<f32>;  // (groups, 4)
@group(0) @binding(1) var<storage, read_write> stats: array<f32>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32) {
    var own = vec4f();
    for (var i = local; i < part_count; i += 256u) {
        own += vec4f(parts[4u * i], parts[4u * i + 1u], parts[4u * i + 2u], parts[4u * i + 3u]);
    }
    let total = summed(own, local);
    if (local == 0u) {
        let mean = total.xyz / max(total.w, 1.0);
        for (var c = 0u; c < 3u; c++) { stats[MEAN_RED + c] = mean[c]; }
        stats[MEAN_ALL] = (mean.x + mean.y + mean.z) / 3.0;
        stats[USABLE] = total.w;
        stats[UNUSABLE] = f32(pixels) - total.w;
        // The power of two that is 2^-light_bits to half of it of the mean light (`whole_light.light_unit`).
        let light = dot(vec3f(guide_rgb[0], guide_rgb[1], guide_rgb[2]), mean);
        let exponent = select(least_exponent, i32(bitcast<u32>(light) >> 23u) - 127i, light > 0.0);
        let place = u32(max(exponent, least_exponent) - i32(light_bits) + 127i);
        stats[UNIT] = bitcast<f32>(place << 23u);
        stats[UNIT + 1u] = bitcast<f32>((254u - place) << 23u);
    }
}
