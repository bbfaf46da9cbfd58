// Averages the signs of blocks: for each plane how much its blocks' evidence falls, as a logarithm, and behind these the
// spread of all the frame.

@group(0) @binding(0) var<storage, read> choice: array<u32>;  // (h, w)
@group(0) @binding(1) var<storage, read> signs: array<vec2f>;  // (blocks,)
@group(0) @binding(2) var<storage, read> plane_count: array<u32>;
@group(0) @binding(3) var<storage, read_write> averages: array<f32>;  // (planes + 1,)

var<workgroup> sums: array<vec2f, 64>;

// Pixels that belong to a block along one axis: to the last one also what is left over.
fn extent(at: u32, blocks: u32, pixels: u32) -> u32 {
    return select(block, pixels - at * block, at == blocks - 1u);
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let across = width / block;
    let down = height / block;
    let of_frame = group.x == planes;
    if (!of_frame && group.x >= plane_count[0]) { return; }
    var sum = vec2f();
    for (var i = local; i < across * down; i += 64u) {
        let y = i / across;
        let x = i % across;
        let plane = choice[(y * block + block / 2u) * width + x * block + block / 2u];
        let pixels = f32(extent(y, down, height) * extent(x, across, width));
        let weight = select(select(0.0, 1.0, plane == group.x), pixels, of_frame);
        sum += weight * vec2f(select(signs[i].y, signs[i].x, of_frame), 1.0);
    }
    sums[local] = sum;
    workgroupBarrier();
    for (var half = 32u; half > 0u; half /= 2u) {
        if (local < half) { sums[local] += sums[local + half]; }
        workgroupBarrier();
    }
    if (local == 0u) {
        let mean = sums[0].x / max(sums[0].y, 1.0);
        averages[group.x] = select(log(max(mean, 0.0) + least_nats), mean, of_frame);
    }
}
