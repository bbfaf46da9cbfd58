// Disparity to millimetres with the curve of every pixel, depth = B / (A - d) + delta, and the error bar of both.

@group(0) @binding(0) var<storage, read> disparity: array<u32>;  // (H, W)
@group(0) @binding(1) var<storage, read> sigma: array<u32>;  // (H, W)
@group(0) @binding(2) var<storage, read> fields: array<f32>;  // of which `field` makes A, B, delta and six covariances
@group(0) @binding(3) var<storage, read> curve: array<f32>;  // (table_count, 5): linear disparity, four errors
@group(0) @binding(4) var<storage, read_write> depth_mm: array<u32>;  // (H, W)
@group(0) @binding(5) var<storage, read_write> sigma_mm: array<u32>;  // (H, W)

// d measured / d linear disparity: Clenshaw's rule for Chebyshev polynomials.
fn slope_at(linear: f32) -> f32 {
    if (linear <= low_px || linear >= high_px) { return 1.0; }
    let s = (2.0 * linear - low_px - high_px) / (high_px - low_px);
    var c0 = slope[slope_count - 2u];
    var c1 = slope[slope_count - 1u];
    for (var n = i32(slope_count) - 3i; n >= 0i; n--) {
        let before = c0;
        c0 = slope[n] - c1;
        c1 = before + c1 * 2.0 * s;
    }
    return 1.0 + (c0 + c1 * s);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= pixels) { return; }
    depth_mm[i] = NAN_BITS;
    sigma_mm[i] = NAN_BITS;
    if (disparity[i] == NAN_BITS) { return; }
    var d = bitcast<f32>(disparity[i]);
    let a = field(0u, i);
    let b = field(1u, i);
    let delta = field(2u, i);
    var k = 0u;
    var part = 0.0;
    if (table_count > 1u) {
        let place = clamp((d - first_px) * per_px, 0.0, f32(table_count - 1u));
        k = min(u32(place), table_count - 2u);
        part = place - f32(k);
        let beyond = min(d - first_px, 0.0) + max(d - last_px, 0.0);  // slope 1 outside
        d = curve[5u * k] + part * (curve[5u * k + 5u] - curve[5u * k]) + beyond;
    }
    if ((a - d) * (max_depth_mm - delta) < b) { return; }  // at infinity, or too far
    let by_b = 1.0 / (a - d);
    let z = b * by_b;
    let by_d = z * by_b;
    var by_reading = by_d;
    if (table_count > 1u) { by_reading = by_d / slope_at(d); }
    var variance = by_d * (by_d * field(3u, i) - 2.0 * (field(5u, i) + by_b * field(4u, i)))
        + by_b * (by_b * field(6u, i) + 2.0 * field(7u, i)) + field(8u, i);
    if (has_errors) {
        let at = 5u * k + 1u;
        let here = vec4f(curve[at], curve[at + 1u], curve[at + 2u], curve[at + 3u]);
        let next = vec4f(curve[at + 5u], curve[at + 6u], curve[at + 7u], curve[at + 8u]);
        let errors = here + part * (next - here);
        variance += by_reading * (by_reading * errors.x + 2.0 * (by_d * errors.y - by_b * errors.z - errors.w));
    }
    let of_reading = by_reading * bitcast<f32>(sigma[i]);
    depth_mm[i] = bitcast<u32>(z + delta);
    sigma_mm[i] = bitcast<u32>(sqrt(of_reading * of_reading + max(variance, 0.0)));
}
