// The plane of every grid point, that of its block.

@group(0) @binding(0) var<storage, read> blocks: array<u32>;  // (height / block, width / block)
@group(0) @binding(1) var<storage, read_write> choice: array<u32>;  // every `spacing`-th pixel

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let across = (width + spacing - 1u) / spacing;
    if (i >= across * ((height + spacing - 1u) / spacing)) { return; }
    choice[i] = blocks[block_at(i / across * spacing, i % across * spacing)];
}
