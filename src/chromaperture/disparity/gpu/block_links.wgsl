// Links between the middles of blocks: the weakest on the way, averaged over the side; see `planar.block_links`.

@group(0) @binding(0) var<storage, read> weights: array<vec2f>;  // (h, w): of pixels, to the right and downwards
@group(0) @binding(1) var<storage, read_write> links: array<f32>;  // (2, h / block, w / block), nats

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let across = width / block;
    let down = height / block;
    if (i >= across * down) { return; }
    let y = i / across;
    let x = i % across;
    var sums = vec2f();
    for (var line = 0u; line < block; line++) {
        var least = vec2f(1.0e30);
        for (var k = 0u; k < block; k++) {
            let along = min(x * block + block / 2u + k, width - 1u);
            let below = min(y * block + block / 2u + k, height - 1u);
            least = min(least, vec2f(
                weights[(y * block + line) * width + along].x, weights[below * width + x * block + line].y
            ));
        }
        sums += least;
    }
    links[i] = penalty * select(1.0, sums.x / f32(block), x + 1u < across);
    links[across * down + i] = penalty * select(1.0, sums.y / f32(block), y + 1u < down);
}
