// The planes, where most of the pixels in a square allow them (a median; borders are continued), else the surface.

@group(0) @binding(0) var<storage, read> plane_labels: array<f32>;
@group(0) @binding(1) var<storage, read> apart: array<f32>;
@group(0) @binding(2) var<storage, read_write> surface: array<vec4f>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let pixel = invocation(group, groups, local);
    if (pixel >= width * height) { return; }
    let x = i32(pixel % width);
    let y = i32(pixel / width);
    let reach = i32(window / 2u);
    var sum = 0.0;
    for (var j = -reach; j <= reach; j++) {
        let row = u32(clamp(y + j, 0i, i32(height) - 1i)) * width;
        for (var i = -reach; i <= reach; i++) { sum += apart[row + u32(clamp(x + i, 0i, i32(width) - 1i))]; }
    }
    if (2.0 * sum < f32(window * window)) { surface[pixel].x = plane_labels[pixel]; }
}
