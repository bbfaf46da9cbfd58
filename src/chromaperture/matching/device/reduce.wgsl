// Area averages of a picture: pixels that lie in two of the reduced ones count in both by their share. NaN where a pixel
// is saturated or not finite: the mean of what was cut off is not known. See `working_scale.py`, reduced.

@group(0) @binding(0) var<storage, read> image: array<f32>;  // (H, W, 3)
@group(0) @binding(1) var<storage, read_write> small: array<u32>;  // (h, w, 3) float32, as bits

// Length of full pixel p in reduced pixel q, in 1 / count of a full pixel; a thousandth is none, as OpenCV has it.
fn overlap(p: u32, q: u32, full_count: u32, count: u32) -> u32 {
    let length = min((p + 1u) * count, (q + 1u) * full_count) - max(p * count, q * full_count);
    return select(length, 0u, 1000u * length <= count);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let x = i % width;
    let y = i / width;
    var sum = vec3f();
    var known = true;
    for (var q = y * full_height / height; q * height < (y + 1u) * full_height; q++) {
        let down = f32(overlap(q, y, full_height, height)) / f32(full_height);
        for (var p = x * full_width / width; p * width < (x + 1u) * full_width; p++) {
            let share = down * f32(overlap(p, x, full_width, width)) / f32(full_width);
            if (share == 0.0) { continue; }
            let at = 3u * (q * full_width + p);
            let rgb = vec3f(image[at], image[at + 1u], image[at + 2u]);
            let finite = is_finite(rgb.x) && is_finite(rgb.y) && is_finite(rgb.z);
            known = known && finite && max(max(rgb.x, rgb.y), rgb.z) < saturation;
            if (known) { sum += share * rgb; }
        }
    }
    for (var c = 0u; c < 3u; c++) { small[3u * i + c] = select(NAN_BITS, bitcast<u32>(sum[c]), known); }
}
