// Log-likelihoods of scores that are read at the labels of equal depth: between layers by Catmull and Rom's cubics.
// Without labels `correlation.wgsl` leaves log-likelihoods at once.

@group(0) @binding(0) var<storage, read> score: array<f32>;  // (h, w, pitch)
@group(0) @binding(1) var<storage, read> labels: array<f32>;  // (2, H, W): offset, scale
@group(0) @binding(2) var<storage, read> planes: array<f32>;  // the mask is the one behind K + 1 others
@group(0) @binding(3) var<storage, read_write> likelihood: array<f32>;  // (h, w, pitch)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height * layer_count) { return; }
    let pixel = i / layer_count;
    let layer = i % layer_count;
    let start = pixel * pitch;
    let label = half_label(pixel % width, pixel / width);
    let place = (label.x + (label.y - 1.0) * first_px) / step_px + label.y * f32(layer);
    let below = clamp(i32(place), 0i, i32(layer_count) - 2i);
    let t = place - f32(below);
    var value = 0.0;
    if (t >= 0.0 && t <= 1.0) {
        let before = score[start + inside(below - 1i, layer_count)];
        let low = score[start + u32(below)];
        let high = score[start + u32(below) + 1u];
        let after = score[start + inside(below + 2i, layer_count)];
        let third = 3.0 * (low - high) + after - before;
        let second = before + before - 5.0 * low + 4.0 * high - after;
        value = low + 0.5 * t * (high - before + t * (second + t * third));
    }
    likelihood[start + layer] = planes[(view_count + 1u) * width * height + pixel] * nats_of(vec4f(value)).x;
}
