// Root mean square distance of the layers from a map, each as probable as exp(-cost / temperature); layers.

@group(0) @binding(0) var<storage, read> surface: array<vec4f>;  // (h, w): layer first
@group(0) @binding(1) var<storage, read> cost: array<f32>;  // (h, w, count)
@group(0) @binding(2) var<storage, read_write> sigma: array<f32>;  // (h, w)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let pixel = invocation(group, groups, local);
    if (pixel >= width * height) { return; }
    let at = pixel * count;
    var least = cost[at];
    for (var k = 1u; k < count; k++) { least = min(least, cost[at + k]); }
    let u = surface[pixel].x;
    var mass = 0.0;
    var moment = 0.0;
    for (var k = 0u; k < count; k++) {
        let probable = exp(-(cost[at + k] - least) / temperature);
        let away = f32(k) - u;
        mass += probable;
        moment += probable * away * away;
    }
    sigma[pixel] = sqrt(moment / mass);
}
