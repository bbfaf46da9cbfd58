// Scores to log-likelihoods, nats, at the labels of equal depth: between layers by Catmull and Rom's cubics.

@group(0) @binding(0) var<storage, read> score: array<f32>;  // (h, w, pitch)
@group(0) @binding(1) var<storage, read> labels: array<f32>;  // (2, H, W): offset, scale; or (2, 1, 1)
@group(0) @binding(2) var<storage, read> planes: array<f32>;  // the mask is the one behind K + 1 others
@group(0) @binding(3) var<storage, read_write> likelihood: array<f32>;  // (h, w, pitch)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height * pitch) { return; }
    let layer = i % pitch;
    let pixel = i / pitch;
    if (layer >= layer_count) {
        likelihood[i] = -closed;  // no layer: it only fills the last vector
        return;
    }
    var value = score[i];
    if (labelled) {
        let at = 2u * (pixel / width) * full_width + 2u * (pixel % width);
        let offset = labels[at] / 2.0;  // of the halved picture
        let scale = labels[full_width * full_height + at];
        let place = (offset + (scale - 1.0) * first_px) / step_px + scale * f32(layer);
        let below = clamp(i32(place), 0i, i32(layer_count) - 2i);
        let t = place - f32(below);
        let start = pixel * pitch;
        let before = score[start + inside(below - 1i, layer_count)];
        let low = score[start + u32(below)];
        let high = score[start + u32(below) + 1u];
        let after = score[start + inside(below + 2i, layer_count)];
        let third = 3.0 * (low - high) + after - before;
        let second = before + before - 5.0 * low + 4.0 * high - after;
        value = low + 0.5 * t * (high - before + t * (second + t * third));
        if (t < 0.0 || t > 1.0) { value = 0.0; }
    }
    value = clamp(value, 0.0, 1.0);
    var determinant = 1.0 - value * value;
    if (view_count == 3u) { determinant = (1.0 - value) * (1.0 - value); }
    likelihood[i] = -0.5 * log(max(determinant, least_determinant)) * planes[(view_count + 1u) * width * height + pixel];
}
