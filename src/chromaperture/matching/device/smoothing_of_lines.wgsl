// As `smoothing.wgsl`, one invocation a line of four maps, two or one, in place: for rasterisers in software, which have
// few invocations at once, and whose barriers are slow. The walk from the end leaves what comes into every eighth sample;
// the walk from the start has eight samples at once in registers. So 3.3 numbers a sample are read or written in place
// of 5, and those that are written are in the cache.

@group(0) @binding(0) var<storage, read_write> maps: array<Maps>;  // (h, w, C / together)
@group(0) @binding(1) var<storage, read> links: array<f32>;  // (2, h, w): along x, along y
@group(0) @binding(2) var<storage, read_write> incoming: array<Maps>;  // (lines, samples / 8, C / together)

const sets = map_count / together;
const each = 8u;  // loops of a constant number of rounds, counted upwards, are unrolled; others index arrays in memory

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32
) {
    let number = invocation(group, groups, local);
    let length = select(height, width, along_x);
    if (number >= select(width, height, along_x) * sets) { return; }
    let line = number / sets;
    let own_set = number % sets;
    let step = sets * select(width, 1u, along_x);  // within eight samples
    let to_next = select(width, 1u, along_x);
    let first_link = select(width * height + line, line * width, along_x);
    let blocks = (length + each - 1u) / each;

    var state = Maps();
    for (var block = blocks; block > 0u; block--) {
        let first = (block - 1u) * each;
        let start = select(first * width + line, line * width + first, along_x) * sets + own_set;
        incoming[(line * blocks + block - 1u) * sets + own_set] = state;
        for (var j = 0u; j < 8u; j++) {  // unrolled
            let i = first + each - 1u - j;
            let last = min(i, length - 1u);
            let link = select(0.0, links[first_link + min(i + 1u, length - 1u) * to_next], i < length - 1u);
            state = select(gain, 1.0, i >= length - 1u) * maps[start + (last - first) * step] + link * state;
        }
    }

    state = Maps();
    for (var block = 0u; block < blocks; block++) {
        let first = block * each;
        let start = select(first * width + line, line * width + first, along_x) * sets + own_set;
        var values: array<Maps, each>;
        var behind: array<Maps, each>;
        var following: array<f32, each>;
        for (var j = 0u; j < 8u; j++) {  // unrolled
            let last = min(first + j, length - 1u);
            values[j] = maps[start + (last - first) * step];
            following[j] = select(0.0, links[first_link + min(first + j + 1u, length - 1u) * to_next], first + j < length - 1u);
        }
        var back = incoming[(line * blocks + block) * sets + own_set];
        for (var j = 0u; j < 8u; j++) {  // unrolled
            let k = each - 1u - j;
            back = select(gain, 1.0, first + k >= length - 1u) * values[k] + following[k] * back;
            behind[k] = back;
        }
        for (var j = 0u; j < 8u; j++) {  // unrolled
            state += select(gain, 1.0, first + j == 0u) * values[j];
            if (first + j < length) { maps[start + j * step] = behind[j] + state - own * values[j]; }
            state *= following[j];
        }
    }
}
