// Weight of the link from every pixel to the one before it, along x and along y: it falls with the guide's change, and
// there is none between layers more than one apart, nor at the ends of a line.

@group(0) @binding(0) var<storage, read> guide: array<f32>;  // planes
@group(0) @binding(1) var<storage, read> stats: array<f32>;
@group(0) @binding(2) var<storage, read> layers: array<f32>;  // (h, w)
@group(0) @binding(3) var<storage, read_write> links: array<f32>;  // (2, h, w)

fn link(here: u32, before: u32) -> f32 {
    let apart = abs(guide[guide_plane + here] - guide[guide_plane + before]) * stats[GUIDE_SCALE] / edge_range;
    var found = even_link * exp(-apart);
    if (by_layer) {
        if (abs(layers[here] - layers[before]) > 1.0) { found = 0.0; }
    }
    return found;
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    links[i] = select(0.0, link(i, max(i, 1u) - 1u), i % width > 0u);
    links[width * height + i] = select(0.0, link(i, max(i, width) - width), i >= width);
}
