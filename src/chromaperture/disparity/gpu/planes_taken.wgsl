// The labels that planes and their surface agree on, decided on the CPU, in place of the surface's.

@group(0) @binding(0) var<storage, read> taken_labels: array<f32>;  // (h, w), layers
@group(0) @binding(1) var<storage, read_write> surface: array<vec4f>;  // (h, w): layer first

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let pixel = invocation(group, groups, local);
    if (pixel >= width * height) { return; }
    surface[pixel].x = taken_labels[pixel];
}
