// Cells beside nearer things know less of their place: `readable/place.py`, `BESIDE_NEARER`.

@group(0) @binding(0) var<storage, read> winner: array<f32>;  // (3, h, w): layer, likelihood there, sigma in layers
@group(0) @binding(1) var<storage, read_write> places: array<vec2f>;  // (h, w): information, place times information

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let pixel = invocation(group, groups, local);
    if (pixel >= width * height) { return; }
    let x = pixel % width;
    let y = pixel / width;
    var nearest = winner[pixel];
    for (var v = max(y, nearer_reach) - nearer_reach; v <= min(y + nearer_reach, height - 1u); v++) {
        for (var u = max(x, nearer_reach) - nearer_reach; u <= min(x + nearer_reach, width - 1u); u++) {
            nearest = min(nearest, winner[v * width + u]);
        }
    }
    if (winner[pixel] - nearest > 1.0) { places[pixel] *= weight; }
}
