// Every so many pixels of the maps and of the picture: what the ranges of colours are found from.

@group(0) @binding(0) var<storage, read> image: array<f32>;  // (H, W, 3)
@group(0) @binding(1) var<storage, read> disparity: array<u32>;  // (H, W)
@group(0) @binding(2) var<storage, read> depth: array<u32>;  // (H, W)
@group(0) @binding(3) var<storage, read> sigma: array<u32>;  // (H, W)
@group(0) @binding(4) var<storage, read_write> sparse: array<u32>;  // (3, h, w): depth, error bar, brightest channel

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let count = sparse_width * sparse_height;
    if (i >= count) { return; }
    let from_pixel = i / sparse_width * step * width + i % sparse_width * step;
    let rgb = aligned(from_pixel);
    sparse[i] = depth[from_pixel];
    sparse[count + i] = sigma[from_pixel];
    sparse[2u * count + i] = bitcast<u32>(max(max(rgb.x, rgb.y), rgb.z));
}
