// Scores to log-likelihoods, nats, at the labels of equal depth: between layers by Catmull and Rom's cubics.

@group(0) @binding(0) var<storage, read> score: array<f32>;  // (h, w, pitch)
@group(0) @binding(1) var<storage, read> labels: array<f32>;  // (2, H, W): offset, scale; or (2, 1, 1)
@group(0) @binding(2) var<storage, read> planes: array<f32>;  // the mask is the one behind K + 1 others
@group(0) @binding(3) var<storage, read_write> likelihood: array<vec4f>;  // (h, w, pitch / 4)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height * pitch / 4u) { return; }
    let pixel = i / (pitch / 4u);
    let first_layer = 4u * (i % (pitch / 4u));
    let start = pixel * pitch;
    let label = half_label(pixel % width, pixel / width);
    let scale = label.y;
    let begin = (label.x + (scale - 1.0) * first_px) / step_px;
    var values = vec4f();
    for (var j = 0u; j < 4u; j++) {
        let layer = first_layer + j;
        if (labelled) {
            let place = begin + scale * f32(layer);
            let below = clamp(i32(place), 0i, i32(layer_count) - 2i);
            let t = place - f32(below);
            let before = score[start + inside(below - 1i, layer_count)];
            let low = score[start + u32(below)];
            let high = score[start + u32(below) + 1u];
            let after = score[start + inside(below + 2i, layer_count)];
            let third = 3.0 * (low - high) + after - before;
            let second = before + before - 5.0 * low + 4.0 * high - after;
            values[j] = select(low + 0.5 * t * (high - before + t * (second + t * third)), 0.0, t < 0.0 || t > 1.0);
        } else {
            values[j] = score[start + layer];
        }
    }
    values = clamp(values, vec4f(), vec4f(1.0));
    var determinant = 1.0 - values * values;
    if (view_count == 3u) { determinant = (1.0 - values) * (1.0 - values); }
    let mask = planes[(view_count + 1u) * width * height + pixel];
    let nats = -0.5 * mask * log(max(determinant, vec4f(least_determinant)));
    // A layer that only fills the last vector costs more than any other.
    let layers = vec4u(0u, 1u, 2u, 3u) + first_layer;
    likelihood[i] = select(nats, vec4f(-closed), layers >= vec4u(layer_count));
}
