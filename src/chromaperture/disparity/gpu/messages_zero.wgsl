// Sets the messages of as many choices as there are to 0.

@group(0) @binding(0) var<storage, read> plane_count: array<u32>;
@group(0) @binding(1) var<storage, read_write> right: array<f32>;  // (pixels, planes), as the others
@group(0) @binding(2) var<storage, read_write> left: array<f32>;
@group(0) @binding(3) var<storage, read_write> down: array<f32>;
@group(0) @binding(4) var<storage, read_write> up: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let size = pixels * plane_count[0];
    let each = (size + parts - 1u) / parts;
    for (var i = group.x * each + local; i < min((group.x + 1u) * each, size); i += 64u) {
        right[i] = 0.0;
        left[i] = 0.0;
        down[i] = 0.0;
        up[i] = 0.0;
    }
}
