// Offset from the nearest layer at which averaged tangents are least, half a layer at most, and the label there.

@group(0) @binding(0) var<storage, read> winner: array<vec3f>;
@group(0) @binding(1) var<storage, read> averaged: array<vec2f>;
@group(0) @binding(2) var<storage, read_write> offset: array<f32>;
@group(0) @binding(3) var<storage, read_write> label: array<f32>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let pixel = invocation(group, groups, local);
    if (pixel >= width * height) { return; }
    let pull = averaged[pixel];
    let o = clamp(-pull.x / max(pull.y, 1.0e-9), -0.5, 0.5);  // 1e-9: even evidence
    offset[pixel] = o;
    label[pixel] = winner[pixel].x + o;
}
