// The factor that brings a guide to units of guide_range: its 1st and 99th percentile over a sparse grid.
// One workgroup finds the values of the four ranks by their bits, eight at a time (radix selection).

@group(0) @binding(0) var<storage, read> planes: array<f32>;
@group(0) @binding(1) var<storage, read_write> stats: array<f32>;

var<workgroup> counts: array<atomic<u32>, 256>;
var<workgroup> prefix: u32;
var<workgroup> rank_left: u32;

// Floats in the order of unsigned integers.
fn ordered(value: f32) -> u32 {
    let bits = bitcast<u32>(value);
    return select(bits | 0x80000000u, ~bits, (bits & 0x80000000u) != 0u);
}

fn sample(i: u32) -> u32 {
    return ordered(planes[first + (i / sparse_width) * sparse * width + (i % sparse_width) * sparse]);
}

fn value_of_rank(rank: u32, local: u32) -> f32 {
    if (local == 0u) {
        prefix = 0u;
        rank_left = rank;
    }
    for (var shift = 24i; shift >= 0i; shift -= 8i) {
        atomicStore(&counts[local], 0u);
        let known = workgroupUniformLoad(&prefix);
        for (var i = local; i < sparse_count; i += 256u) {
            let bits = sample(i);
            let same = shift == 24i || (bits >> u32(shift + 8i)) == (known >> u32(shift + 8i));
            if (same) { atomicAdd(&counts[(bits >> u32(shift)) & 255u], 1u); }
        }
        workgroupBarrier();
        if (local == 0u) {
            var left = rank_left;
            var digit = 0u;
            for (; digit < 255u; digit++) {
                let here = atomicLoad(&counts[digit]);
                if (left < here) { break; }
                left -= here;
            }
            rank_left = left;
            prefix = known | (digit << u32(shift));
        }
        workgroupBarrier();
    }
    let found = workgroupUniformLoad(&prefix);
    return bitcast<f32>(select(~found, found & 0x7fffffffu, (found & 0x80000000u) != 0u));
}

fn percentile(place: f32, local: u32) -> f32 {
    let below = u32(floor(place));
    let low = value_of_rank(below, local);
    let high = value_of_rank(min(below + 1u, sparse_count - 1u), local);
    return low + (place - floor(place)) * (high - low);
}

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32) {
    let low = percentile(low_place, local);
    let high = percentile(high_place, local);
    if (local == 0u) {
        stats[GUIDE_SCALE + slot] = 1.0 / (max(high - low, 1.0e-6) * guide_range);  // 1e-6: an even guide
    }
}
