// Mean and variance of the layers, each as probable as exp(-cost / temperature); layers. Moments are taken about the
// layer of least cost: about the first, float32 would lose a narrow variance.

@group(0) @binding(0) var<storage, read> cost: array<f32>;  // (h, w, count)
@group(0) @binding(1) var<storage, read_write> posterior: array<vec2f>;  // (h, w)

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
        best = select(best, k, here < least);
        least = min(least, here);
    }
    var mass = 0.0;
    var moments = vec2f();
    for (var k = 0u; k < count; k++) {
        let probable = exp(-(cost[at + k] - least) / temperature);
        let away = f32(k) - f32(best);
        mass += probable;
        moments += probable * vec2f(away, away * away);
    }
    moments /= mass;
    posterior[pixel] = vec2f(f32(best) + moments.x, max(moments.y - moments.x * moments.x, 0.0));
}
