// Negative log-likelihoods of lines across an edge: a workgroup has one place of the edge, and one part after another of
// the lines; see `edge_likelihood.py` and `stages/edge_costs.py`. A line is its first sample and differences of
// neighbours: their covariances have little of what all samples share, which single precision would lose the rest in.
// The determinant stays the same. Lines are further columns of the matrix while it is eliminated.

@group(0) @binding(0) var<storage, read> textures: array<vec4f>;  // (textures, 9, 4 samples - 1), see `_texture`
@group(0) @binding(1) var<storage, read> shares: array<f32>;  // (textures, places, n) of a half plane's light
@group(0) @binding(2) var<storage, read> parts: array<Part>;
@group(0) @binding(3) var<storage, read> numbers: array<u32>;  // of lines, of parts
@group(0) @binding(4) var<storage, read> shared_by_all: array<f32>;  // colours (3, 3), noise (samples, samples)
@group(0) @binding(5) var<storage, read> smooth_light: array<f32>;  // (h, w, 3)
@group(0) @binding(6) var<storage, read> lines: array<vec2u>;  // grid point first
@group(0) @binding(7) var<storage, read_write> costs: array<f32>;  // (lines, places)

const n = 3u * samples;
const fours = (n + 3u) / 4u;  // of columns
const row_length = fours + most_lines / 4u;
const kinds = 4u * samples - 1u;  // pairs of samples: by their distance, and those of the first sample

var<workgroup> matrix: array<vec4f, n * row_length>;  // upper triangle, then the lines
var<workgroup> share: array<f32, n>;  // of the near side
var<workgroup> rise: array<f32, n>;  // of the share, from the sample before

// Covariance of two numbers of a line on one side, whose shares and their rises are these.
fn of_side(covariances: vec4f, here: f32, rise_here: f32, there: f32, rise_there: f32) -> f32 {
    return here * (there * covariances.x + rise_there * covariances.y)
        + rise_here * (there * covariances.z + rise_there * covariances.w);
}

// Sample i of a line, or what it has more than the one before.
fn of_line(line: u32, i: u32) -> f32 {
    let down = lines[line].x >= width * height;
    let point = select(lines[line].x, lines[line].x - width * height, down);
    let stride = select(1u, width, down);
    let step = i % samples;
    let at = 3u * (point + step * stride - (samples / 2u - 1u) * stride) + i / samples;
    return smooth_light[at] - select(smooth_light[max(at, 3u * stride) - 3u * stride], 0.0, step == 0u);
}

fn costs_of(part: u32, place: u32, local: u32) {
    let which = parts[part].sides;  // near texture, far texture, whether the near side comes first
    let count = parts[part].count;
    let power = parts[part].values;  // near, far, level, least variance
    let noise = parts[part].noise;
    for (var i = local; i < n; i += lanes) {
        let first = (which.x * places + place) * n;
        let before = shares[first + i];
        let step = select(before - shares[first + max(i, 1u) - 1u], 0.0, i % samples == 0u);
        share[i] = select(before, 1.0 - before, which.z == 1u);
        rise[i] = select(step, -step, which.z == 1u);
    }
    workgroupBarrier();
    for (var i = local; i < n; i += lanes) {
        let one = i % samples;
        let here = share[i];
        let rise_here = rise[i];
        // What a surface's mean light adds: the rise of the share, of the first sample the share.
        let near_mean = power.z * select(rise_here, here, one == 0u);
        let far_mean = power.z * select(-rise_here, 1.0 - here, one == 0u);
        for (var four = i / 4u; four < fours; four++) {
            var sums = vec4f();
            for (var k = 0u; k < 4u; k++) {
                let j = min(4u * four + k, n - 1u);
                let other = j % samples;
                let there = share[j];
                let rise_there = rise[j];
                let pair = 3u * (i / samples) + j / samples;
                let distance = select(one + samples - 1u - other, 3u * samples - 1u + one, other == 0u);
                let kind = pair * kinds + select(distance, 2u * samples - 1u + other, one == 0u);
                let near = of_side(textures[which.x * 9u * kinds + kind], here, rise_here, there, rise_there);
                let far = of_side(
                    textures[which.y * 9u * kinds + kind], 1.0 - here, -rise_here, 1.0 - there, -rise_there
                );
                var sum = power.x * near + power.y * far
                    + near_mean * select(rise_there, there, other == 0u)
                    + far_mean * select(-rise_there, 1.0 - there, other == 0u);
                sum *= shared_by_all[pair];
                // The least variance is that of samples, which differences have twice, and share with the next.
                let apart = max(one, other) - min(one, other);
                let floor_here = select(select(0.0, -1.0, apart == 1u), select(2.0, 1.0, one == 0u), apart == 0u);
                let spread = noise[i / samples] * shared_by_all[9u + one * samples + other] + power.w * floor_here;
                sums[k] = sum + select(0.0, spread, i / samples == j / samples);
            }
            matrix[i * row_length + four] = sums;
        }
        for (var four = 0u; four < (count + 3u) / 4u; four++) {
            var given = vec4f();
            for (var k = 0u; k < 4u; k++) {
                given[k] = of_line(parts[part].members[min(4u * four + k, count - 1u)], i);
            }
            matrix[i * row_length + fours + four] = given;
        }
    }
    let last = fours + (count + 3u) / 4u;
    // Two rows at a time: what they are taken from is loaded half as often.
    for (var k = 0u; k < n; k += 2u) {
        workgroupBarrier();
        let pivot = k * row_length;
        let next = pivot + row_length;
        let scale = 1.0 / max(matrix[pivot + k / 4u][k % 4u], 1.0e-3 * power.w);
        let of_next = matrix[pivot + k / 4u][k % 4u + 1u] * scale;  // k is even: the same vector has the next number
        workgroupBarrier();
        for (var four = k / 4u + local; four < last; four += lanes) {
            matrix[next + four] -= of_next * matrix[pivot + four];
        }
        workgroupBarrier();
        let next_scale = 1.0 / max(matrix[next + k / 4u][k % 4u + 1u], 1.0e-3 * power.w);
        // Row i is always the same invocation's.
        for (var i = (k + 1u + lanes - local) / lanes * lanes + local; i < n; i += lanes) {
            let factor = matrix[pivot + i / 4u][i % 4u] * scale;
            let further = matrix[next + i / 4u][i % 4u] * next_scale;
            for (var four = i / 4u; four < last; four++) {
                matrix[i * row_length + four] -= factor * matrix[pivot + four] + further * matrix[next + four];
            }
        }
    }
    workgroupBarrier();
    for (var four = local; four < (count + 3u) / 4u; four += lanes) {
        var sums = vec4f();
        for (var k = 0u; k < n; k++) {
            let variance = max(matrix[k * row_length + k / 4u][k % 4u], 1.0e-3 * power.w);
            let here = matrix[k * row_length + fours + four];
            sums += log(variance) + here * here / variance;
        }
        for (var k = 0u; k < min(4u, count - 4u * four); k++) {
            costs[parts[part].members[4u * four + k] * places + place] = 0.5 * sums[k];
        }
    }
}

@compute @workgroup_size(lanes)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    for (var part = group.x; part < numbers[1]; part += side_by_side) {
        costs_of(part, group.y, local);
        workgroupBarrier();
    }
}
