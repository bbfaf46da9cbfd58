// Light and coverage of a layer in its box, 0 where it is absent: means of cells. Beyond the box its last rows and columns
// go on.

@group(0) @binding(0) var<storage, read> color: array<f32>;  // (H, W, 3)
@group(0) @binding(1) var<storage, read> behind: array<f32>;  // (H, W, 3): what near surfaces hide
@group(0) @binding(2) var<storage, read> radius: array<f32>;  // (H, W): new blur of both; far beyond all where nothing is
@group(0) @binding(3) var<storage, read> behind_radius: array<f32>;  // hidden
@group(0) @binding(4) var<storage, read> layer: Layer;
@group(0) @binding(5) var<storage, read_write> cells: array<vec4f>;  // (cells_tall, cells_wide)

// Linear to the neighbouring layers' radii.
fn weight_of(r: f32) -> f32 {
    if (r <= layer.below || r >= layer.above) { return 0.0; }
    if (r < layer.here) { return (r - layer.below) / (layer.here - layer.below); }
    return (layer.above - r) / (layer.above - layer.here);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= layer.cells_tall * layer.cells_wide) { return; }
    let first = layer.scale * vec2u(i % layer.cells_wide, i / layer.cells_wide);
    var sum = vec4f();
    for (var dy = 0u; dy < layer.scale; dy++) {
        let y = layer.top + min(first.y + dy, layer.tall - 1u);
        for (var dx = 0u; dx < layer.scale; dx++) {
            let at = y * width + layer.left + min(first.x + dx, layer.wide - 1u);
            let a = weight_of(radius[at]);
            let b = weight_of(behind_radius[at]);
            if (a == 0.0 && b == 0.0) { continue; }
            let light = vec3f(color[3u * at], color[3u * at + 1u], color[3u * at + 2u]);
            let hidden = vec3f(behind[3u * at], behind[3u * at + 1u], behind[3u * at + 2u]);
            sum += vec4f(a * light + b * hidden, a + b);
        }
    }
    cells[i] = sum / f32(layer.scale * layer.scale);
}
