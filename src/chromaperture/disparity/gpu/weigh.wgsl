// Scores of a chunk of layers times their pixels' weights, and the weights themselves as one more map.

@group(0) @binding(0) var<storage, read> score: array<f32>;  // (h, w, C)
@group(0) @binding(1) var<storage, read> planes: array<f32>;  // the mask is the one behind K + 1 others
@group(0) @binding(2) var<storage, read_write> maps: array<f32>;  // (h, w, C + 1)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let each = layer_count + 1u;
    if (i >= pixels * each) { return; }
    let layer = i % each;
    let pixel = i / each;
    let weight = max(planes[(view_count + 1u) * pixels + pixel], least_weight);
    var value = 1.0;
    if (layer < layer_count) { value = score[pixel * layer_count + layer]; }
    maps[i] = weight * value;
}
