// A parabola through the best layer and its neighbours, and from its shape the error bar (quality "paper"), as
// `error_bar.peak_sigma`.

@group(0) @binding(0) var<storage, read> best: array<f32>;  // (5, H, W): layer, before, at, after, last score
@group(0) @binding(1) var<storage, read_write> peaks: array<f32>;  // (3, H, W): disparity, its error bar, score

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= pixels) { return; }
    let layer = best[i];
    let before = best[pixels + i];
    let at = best[2u * pixels + i];
    let after = best[3u * pixels + i];
    let bend = max(2.0 * at - before - after, 0.0);
    var offset = 0.0;
    var peak = at;
    if (bend > 1.0e-12) {  // a flat top has no vertex; scores are of order 1
        offset = clamp((after - before) / (2.0 * bend), -0.5, 0.5);
        peak = at + (after - before) * (after - before) / (8.0 * bend);
    }
    let curvature = max(bend / (step_px * step_px), 1.0e-9);
    let high = clamp(peak, 1.0e-3, 1.0 - 1.0e-6);  // a peak of 0 or 1 would make the variance infinite or 0
    var variance = (1.0 - high) / (samples * curvature);
    if (view_count == 2u) { variance *= (1.0 + high) / high; }
    let wide = min(sigma_scale * sqrt(variance), max_sigma_px);
    let known = layer > 0.0 && layer < f32(total_layers - 1u) && wide < range_sigma_px;
    peaks[i] = select(UNKNOWN, first_px + step_px * (layer + offset), known);
    peaks[pixels + i] = wide;
    peaks[2u * pixels + i] = peak;
}
