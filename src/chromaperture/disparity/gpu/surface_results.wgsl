// What leaves the device: layer, standard deviation of the posterior and range about the pixel, in layers, and the
// correlation at the nearest layer.

@group(0) @binding(0) var<storage, read> surface: array<vec4f>;
@group(0) @binding(1) var<storage, read> sigma: array<f32>;
@group(0) @binding(2) var<storage, read> extent: array<vec4f>;  // largest and smallest layer about the pixel
@group(0) @binding(3) var<storage, read> likelihood: array<f32>;  // (h, w, count)
@group(0) @binding(4) var<storage, read_write> results: array<vec4f>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let pixel = invocation(group, groups, local);
    if (pixel >= width * height) { return; }
    let u = surface[pixel].x;
    let layer = u32(clamp(floor(u + 0.5), 0.0, f32(count - 1u)));
    let explained = max(1.0 - exp(-2.0 * likelihood[pixel * count + layer]), 0.0);
    results[pixel] = vec4f(u, sigma[pixel], extent[pixel].x - extent[pixel].y, sqrt(explained));
}
