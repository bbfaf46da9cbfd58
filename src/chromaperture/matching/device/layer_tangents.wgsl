// Tangents of the log of the unexplained fraction at the last offset from the nearest layer; see
// `readable/between_layers.py`. Their averages give the next offset (`layer_offsets.wgsl`).

@group(0) @binding(0) var<storage, read> winner: array<vec3f>;
@group(0) @binding(1) var<storage, read> offset: array<f32>;
@group(0) @binding(2) var<storage, read_write> tangents: array<vec2f>;  // slope and bend

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let pixel = invocation(group, groups, local);
    if (pixel >= width * height) { return; }
    let about = winner[pixel];
    let o = select(offset[pixel], 0.0, is_first);
    let unexplained = max(1.0 + o * (about.y + o * about.z), least_unexplained);
    tangents[pixel] = vec2f(about.y, 2.0 * about.z) / unexplained;
}
