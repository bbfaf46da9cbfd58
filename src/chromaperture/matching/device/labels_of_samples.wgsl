// Unexplained fractions at the labels of a map, of every sample; see `readable/paths.py`, read_at_labels. A workgroup has
// one sample. A map varies so little between samples that pixels need no polynomials of their own.

@group(0) @binding(0) var<storage, read> unexplained: array<f32>;  // (samples, layers)
@group(0) @binding(1) var<storage, read> label_map: array<vec2f>;  // (h, w) or (1,): offset and scale, in layers
@group(0) @binding(2) var<storage, read_write> at_labels: array<f32>;  // (samples, count)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let sample = group.x + group.y * groups.x;
    if (sample >= sample_width * sample_height) { return; }
    for (var k = local; k < layers; k += 64u) { ladder[k + 2u] = unexplained[sample * layers + k]; }
    continue_ladder(local);
    let x = min(sample % sample_width * spacing, width - 1u);
    let y = min(sample / sample_width * spacing, height - 1u);
    let map = label_map[select(y * width + x, 0u, one_map)];
    for (var n = local; n < count; n += 64u) {
        at_labels[sample * count + n] = unexplained_at(map.x + map.y * (first_label + label_step * f32(n)));
    }
}
