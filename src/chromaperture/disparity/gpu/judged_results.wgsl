// What leaves the device: layer, standard deviation in layers, correlation at the nearest layer, whether it is known.

@group(0) @binding(0) var<storage, read> surface: array<vec4f>;  // (h, w): layer first
@group(0) @binding(1) var<storage, read> bar: array<f32>;  // (h, w): logarithm
@group(0) @binding(2) var<storage, read> known: array<u32>;  // (h, w)
@group(0) @binding(3) var<storage, read> likelihood: array<f32>;  // (h, w, count)
@group(0) @binding(4) var<storage, read_write> results: array<vec4f>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let u = surface[i].x;
    let layer = u32(clamp(floor(u + 0.5), 0.0, f32(count - 1u)));
    let explained = max(1.0 - exp(-2.0 * likelihood[i * count + layer]), 0.0);
    let learned = exp(bar[i]);
    results[i] = vec4f(u, sqrt(learned * learned + bias * bias), sqrt(explained), f32(known[i]));
}
