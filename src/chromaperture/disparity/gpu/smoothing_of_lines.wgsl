// As `smoothing.wgsl`, one invocation a line of four maps, two or one: for rasterisers in software, which have few invocations at once, and
// whose barriers are slow.

@group(0) @binding(0) var<storage, read> maps: array<Maps>;  // (h, w, C / together)
@group(0) @binding(1) var<storage, read> links: array<f32>;  // (2, h, w): along x, along y
@group(0) @binding(2) var<storage, read_write> sums: array<Maps>;  // (h, w, C / together)

const sets = map_count / together;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let number = invocation(group, groups, local);
    let lines = select(width, height, along_x);
    let length = select(height, width, along_x);
    if (number >= lines * sets) { return; }
    let line = number / sets;
    let first = select(line, line * width, along_x);  // its first pixel, and from one to the next
    let step = select(width, 1u, along_x);
    let to_links = select(width * height, 0u, along_x);
    let own_set = number % sets;
    var state = maps[(first + (length - 1u) * step) * sets + own_set];
    sums[(first + (length - 1u) * step) * sets + own_set] = state;
    for (var i = length - 1u; i > 0u; i--) {
        let pixel = first + (i - 1u) * step;
        state = gain * maps[pixel * sets + own_set] + links[to_links + pixel + step] * state;
        sums[pixel * sets + own_set] = state;
    }
    state = maps[first * sets + own_set];
    sums[first * sets + own_set] += state - own * state;
    for (var i = 1u; i < length; i++) {
        let pixel = first + i * step;
        let value = maps[pixel * sets + own_set];
        state = gain * value + links[to_links + pixel] * state;
        sums[pixel * sets + own_set] += state - own * value;
    }
}
