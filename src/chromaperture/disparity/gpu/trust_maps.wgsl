// What is averaged for the trust in a fit's planes, of every block; see `plane_voting.py`: the share of its pixels that
// lie apart from their plane, and with the first fit the surface's variance and how far neighbours differ.

@group(0) @binding(0) var<storage, read> choices: array<u32>;  // (fits, h / block, w / block)
@group(0) @binding(1) var<storage, read> kept: array<vec4f>;  // planes of all fits: layers, of blocks
@group(0) @binding(2) var<storage, read> surface: array<vec4f>;  // (h, w): layer first
@group(0) @binding(3) var<storage, read> sigma: array<f32>;  // (h, w), layers
@group(0) @binding(4) var<storage, read_write> maps: array<f32>;  // (1 + fits, blocks): variance, shares apart
@group(0) @binding(5) var<storage, read_write> differences: array<f32>;  // (blocks,), layers
@group(0) @binding(6) var<storage, read_write> heights: array<f32>;  // (blocks,): the surface, layers
@group(0) @binding(7) var<storage, read_write> counts: array<atomic<u32>>;  // (planes, 2): pixels, of which apart

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let i = invocation(group, groups, local);
    let across = width / block;
    let blocks = across * (height / block);
    if (i >= blocks) { return; }
    let plane = choices[fit * blocks + i];
    let slope = kept[plane].xy / f32(block);
    let corner = vec2u(i % across, i / across);
    // At the first pixel, half a block from the middle.
    let start = dot(kept[plane].xyz, vec3f(vec2f(corner), 1.0)) - 0.5 * f32(block - 1u) * (slope.x + slope.y);
    var apart = 0u;
    var variance = 0.0;
    var unlike = 0.0;
    var layers = 0.0;
    for (var y = 0u; y < block; y++) {
        for (var x = 0u; x < block; x++) {
            let at = (corner.y * block + y) * width + corner.x * block + x;
            let here = surface[at].x;
            let bar = sqrt(sigma[at] * sigma[at] + 1.0);  // with a label's own place
            apart += select(0u, 1u, abs(start + dot(slope, vec2f(f32(x), f32(y))) - here) > sigmas * bar);
            if (fit == 0u) {
                let right = select(at, at + 1u, at % width + 1u < width);
                let below = select(at, at + width, at + width < width * height);
                unlike += min(abs(surface[right].x - here) + abs(surface[below].x - here), most_difference);
                variance += sigma[at] * sigma[at];
                layers += here;
            }
        }
    }
    let share = 1.0 / f32(block * block);
    maps[(1u + fit) * blocks + i] = share * f32(apart);
    atomicAdd(&counts[2u * plane], block * block);
    atomicAdd(&counts[2u * plane + 1u], apart);
    if (fit == 0u) {
        maps[i] = share * variance;
        differences[i] = share * unlike;
        heights[i] = share * layers;
    }
}
