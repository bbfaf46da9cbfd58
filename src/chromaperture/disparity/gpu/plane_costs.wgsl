// Cost of every plane at every block: minus the log-likelihood, linear between two labels; see `stages/planes.py`.

@group(0) @binding(0) var<storage, read> blocks: array<f32>;  // (h, w, count)
@group(0) @binding(1) var<storage, read> planes: array<vec4f>;  // (planes,): a, b, c in layers, cost of the slope
@group(0) @binding(2) var<storage, read> plane_count: array<u32>;
@group(0) @binding(3) var<storage, read_write> cost: array<f32>;  // (h, w, planes)

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let block = group.x + group.y * groups.x;
    if (block >= width * height) { return; }
    let number = plane_count[0];
    for (var k = local; k < number; k += 64u) {
        let plane = planes[k];
        let place = plane.x * f32(block % width) + plane.y * f32(block / width) + plane.z;
        var found = outside;
        if (place >= 0.0 && place <= f32(count - 1u)) {
            let below = min(u32(place), count - 2u);
            found = -mix(blocks[block * count + below], blocks[block * count + below + 1u], place - f32(below));
        }
        cost[block * number + k] = found + plane.w;
    }
}
