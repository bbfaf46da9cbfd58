// From here on a layer hides what comes behind it.

@group(0) @binding(0) var<storage, read> cover: array<f32>;  // (H, W): of the layer, in its box
@group(0) @binding(1) var<storage, read> layer: Layer;
@group(0) @binding(2) var<storage, read_write> before: array<f32>;  // (H, W)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= layer.tall * layer.wide) { return; }
    let at = (layer.top + i / layer.wide) * width + layer.left + i % layer.wide;
    before[at] += cover[at];
}
