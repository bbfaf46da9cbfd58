// The logarithm of the learned error bar, a weighted sum of signs; see `learned_error_bar.py`. Signs count in layers.

@group(0) @binding(0) var<storage, read> pooled: array<vec2f>;  // (h, w): variance, share whose plane was not taken
@group(0) @binding(1) var<storage, read> wide: array<f32>;  // (h, w): that share in wider windows
@group(0) @binding(2) var<storage, read> near_range: array<vec4f>;  // (h, w): largest and smallest about the pixel
@group(0) @binding(3) var<storage, read> wide_range: array<vec4f>;  // (h, w)
@group(0) @binding(4) var<storage, read> planes: array<vec2f>;  // (planes,): scatter, rejected
@group(0) @binding(5) var<storage, read> blocks: array<vec2f>;  // (blocks,): spread, sharpness
@group(0) @binding(6) var<storage, read> averages: array<f32>;  // (planes + 1,): last the spread of the frame
@group(0) @binding(7) var<storage, read_write> bar: array<u32>;  // (h, w): the plane's number, then the logarithm's bits

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    if (i >= width * height) { return; }
    let plane = bar[i];
    let near = near_range[i].x - near_range[i].y;
    let far = wide_range[i].x - wide_range[i].y;
    var sum = constant + weighed_surface(pooled[i].x, near, far);
    sum += weighed(pooled[i].y, apart[0], apart[1], apart[2]);
    sum += weighed(wide[i], apart_wide[0], apart_wide[1], apart_wide[2]);
    sum += weighed(planes[plane].x, scatter[0], scatter[1], scatter[2]);
    sum += weighed(planes[plane].y, rejected[0], rejected[1], rejected[2]);
    let of_block = blocks[block_at(i / width, i % width)];
    sum += weighed(of_block.x, spread[0], spread[1], spread[2]);
    sum += weighed(of_block.y, sharpness[0], sharpness[1], sharpness[2]);
    sum += weighed(averages[number], spread_of_frame[0], spread_of_frame[1], spread_of_frame[2]);
    bar[i] = bitcast<u32>(sum);
}
