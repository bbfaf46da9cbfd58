// Every so many rows and columns of a map, which is smooth in between: see `color/alignment.py`, fill_unknown.

@group(0) @binding(0) var<storage, read> values: array<u32>;  // (H, W)
@group(0) @binding(1) var<storage, read_write> few: array<u32>;  // (few_tall, few_wide)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= few_tall * few_wide) { return; }
    few[i] = values[(spacing / 2u + spacing * (i / few_wide)) * width + spacing / 2u + spacing * (i % few_wide)];
}
