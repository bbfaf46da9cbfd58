// Unknown pixels take what `every_nth.wgsl` and the search for the nearest known pixel found for their square.

@group(0) @binding(0) var<storage, read> values: array<u32>;  // (H, W), NaN unknown
@group(0) @binding(1) var<storage, read> few: array<f32>;  // (few_tall, few_wide)
@group(0) @binding(2) var<storage, read_write> filled: array<f32>;  // (H, W)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    if (values[i] != NAN_BITS) {
        filled[i] = bitcast<f32>(values[i]);
        return;
    }
    filled[i] = few[min(i / width / spacing, few_tall - 1u) * few_wide + min(i % width / spacing, few_wide - 1u)];
}
