// The layer of least cost of every pixel, and how the log-likelihood runs about it: for `layer_offsets.wgsl`.

@group(0) @binding(0) var<storage, read> cost: array<f32>;  // (h, w, count)
@group(0) @binding(1) var<storage, read> likelihood: array<f32>;  // (h, w, count)
// (h, w): nearest inner layer, slope and bend of the unexplained fraction about it
@group(0) @binding(2) var<storage, read_write> winner: array<vec3f>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let pixel = invocation(group, groups, local);
    if (pixel >= width * height) { return; }
    let at = pixel * count;
    var best = 0u;
    var least = cost[at];
    for (var k = 1u; k < count; k++) {
        let here = cost[at + k];
        if (here < least) {
            least = here;
            best = k;
        }
    }
    // A parabola through the costs may round to a neighbour only at half a layer exactly; then both are as near.
    let middle = clamp(best, 1u, count - 2u);
    let own = likelihood[at + middle];
    let left = exp(2.0 * (own - likelihood[at + middle - 1u]));
    let right = exp(2.0 * (own - likelihood[at + middle + 1u]));
    winner[pixel] = vec3f(f32(middle), (right - left) / 2.0, max((left + right) / 2.0 - 1.0, 0.0));
}
