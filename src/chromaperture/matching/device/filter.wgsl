// Recursions along rows and columns over links between neighbours.

// ---- links: indexing, shared
// Weight of the link from every pixel to the one before it, along x and along y: it falls with the guide's change, and
// there is none between layers more than one apart, nor at the ends of a line.

in guide: array<f32>;  // planes
in stats: array<f32>;
in layers: array<f32>;  // (h, w)
out links: array<f32>;  // (2, h, w)

fn link(here: u32, before: u32) -> f32 {
    let apart = abs(guide[guide_plane + here] - guide[guide_plane + before]) * stats[GUIDE_SCALE] / edge_range;
    var found = even_link * exp(-apart);
    if (by_layer) {
        if (abs(layers[here] - layers[before]) > 1.0) { found = 0.0; }
    }
    return found;
}

fn main(i) {
    if (i >= width * height) { return; }
    links[i] = select(0.0, link(i, max(i, 1u) - 1u), i % width > 0u);
    links[width * height + i] = select(0.0, link(i, max(i, width) - width), i >= width);
}

// ---- smoothing: indexing, shared
// Recursions from both ends of every line, over the links of `links`: f(i) = gain x(i) + link(i)
// f(i - 1), the first sample without the gain; the sum of both less `own` x. Lines are the rows or the columns of maps
// (h, w, C). A workgroup takes eight lines in 32 segments: every segment first sums itself up, so that each knows what
// comes in from its two sides before it is walked again. Used by the smoothing along the surface and by the bilateral
// filter of the scores.

in maps: array<f32>;  // (h, w, pitch)
in links: array<f32>;  // (2, h, w): along x, along y
out sums: array<f32>;  // (h, w, pitch)

struct Segment {
    ahead: f32,  // what it hands on to the next segment, of what comes in none
    through: f32,  // and of what comes in from the one before, this fraction
    back: f32,  // the same in the other direction
    through_back: f32,
}

var<workgroup> segments: array<Segment, 256>;

fn pixel_of(line: u32, i: u32) -> u32 {
    return select(i * width + line, line * width + i, along_x);
}

// Weight of the link between a pixel of a line and the one before it; none at the ends.
fn link_to(line: u32, i: u32) -> f32 {
    if (i >= select(height, width, along_x)) { return 0.0; }
    return links[select(width * height, 0u, along_x) + pixel_of(line, i)];
}

@workgroup_size(256)
fn main(group, groups, local) {
    let lines = select(width, height, along_x);
    let length = select(height, width, along_x);
    let number = (group.x + group.y * groups.x) * 8u + local % 8u;
    let used = number < lines * map_count;
    let line = select(0u, number / map_count, used);
    let map = number % map_count;
    let segment = local / 8u;
    let each = (length + 31u) / 32u;
    let first = min(segment * each, length);
    let end = min(first + each, length);

    var own_sums = Segment(0.0, 1.0, 0.0, 1.0);
    var product = 1.0;  // of the links within
    for (var i = first; i < end; i++) {
        let value = maps[pixel_of(line, i) * pitch + map];
        let link = select(link_to(line, i), 1.0, i == first);
        product *= link;
        own_sums.ahead = select(gain, 1.0, i == 0u) * value + select(link * own_sums.ahead, 0.0, i == first);
        own_sums.back += product * select(gain, 1.0, i == length - 1u) * value;
    }
    let entering = link_to(line, first);
    let leaving = link_to(line, end);
    own_sums.through = product * entering;
    own_sums.through_back = product * leaving;
    segments[local] = own_sums;
    workgroupBarrier();
    if (!used || first >= end) { return; }

    var state = 0.0;
    for (var s = 31u; s > segment; s--) {
        let other = segments[8u * s + local % 8u];
        state = other.back + other.through_back * state;
    }
    for (var i = end; i > first; i--) {
        let at = pixel_of(line, i - 1u) * pitch + map;
        let link = select(link_to(line, i), leaving, i == end);
        state = select(gain, 1.0, i == length) * maps[at] + link * state;
        sums[at] = state;
    }
    state = 0.0;
    for (var s = 0u; s < segment; s++) {
        let other = segments[8u * s + local % 8u];
        state = other.ahead + other.through * state;
    }
    for (var i = first; i < end; i++) {
        let at = pixel_of(line, i) * pitch + map;
        let value = maps[at];
        state = select(gain, 1.0, i == 0u) * value + link_to(line, i) * state;
        sums[at] += state - own * value;
    }
}
