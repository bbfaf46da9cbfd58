// Log-likelihoods of every pixel: linear between the unexplained fractions of samples, and what windows of all channels
// say besides. A workgroup has the pixels of a row between two samples.

@group(0) @binding(0) var<storage, read> at_labels: array<f32>;  // (samples, count)
@group(0) @binding(1) var<storage, read> counted: array<f32>;  // (h, w): how much of the pairs' evidence is its own
@group(0) @binding(2) var<storage, read_write> likelihood: array<f32>;  // (h, w, count) nats

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let cell = group.x + group.y * groups.x;
    if (cell >= sample_width * height) { return; }
    let y = cell / sample_width;
    let left = cell % sample_width;
    let right = min(left + 1u, sample_width - 1u);
    let above = min(y / spacing, sample_height - 1u) * sample_width;
    let below = min(y / spacing + 1u, sample_height - 1u) * sample_width;
    let down = f32(y % spacing) / f32(spacing);
    let first = left * spacing;
    for (var n = local; n < count; n += 64u) {
        let before = mix(at_labels[(above + left) * count + n], at_labels[(below + left) * count + n], down);
        let behind = mix(at_labels[(above + right) * count + n], at_labels[(below + right) * count + n], down);
        for (var x = first; x < min(first + spacing, width); x++) {
            let value = mix(before, behind, f32(x - first) / f32(spacing));
            let pixel = y * width + x;
            likelihood[pixel * count + n] = counted[pixel] * max(-factors / 2.0 * log(value), 0.0) + of_windows(x, y, n);
        }
    }
}
