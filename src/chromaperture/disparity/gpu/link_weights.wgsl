// Weights of the links to the right and downwards: 1 on an even guide, `edge_floor` across its edges.

@group(0) @binding(0) var<storage, read> guide: array<f32>;  // (h, w)
@group(0) @binding(1) var<storage, read_write> links: array<vec2f>;  // (h, w); 1 in the last column and row

fn link_to(here: f32, there: f32) -> f32 {
    return edge_floor + (1.0 - edge_floor) * exp(-abs(here - there) / edge_range);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let pixel = invocation(group, groups, local);
    if (pixel >= width * height) { return; }
    let here = guide[pixel];
    var found = vec2f(1.0);
    if (pixel % width + 1u < width) { found.x = link_to(here, guide[pixel + 1u]); }
    if (pixel / width + 1u < height) { found.y = link_to(here, guide[pixel + width]); }
    links[pixel] = found;
}
