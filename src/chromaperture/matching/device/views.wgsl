// Views, guide and mask of a picture, and how they are smoothed.

// ---- light_reduction
// Sums over a workgroup, for `light` and `light_sum`.

var<workgroup> sums: array<vec4f, 256>;

fn summed(own: vec4f, local: u32) -> vec4f {
    sums[local] = own;
    for (var reach = 128u; reach > 0u; reach /= 2u) {
        workgroupBarrier();
        if (local < reach) { sums[local] += sums[local + reach]; }
    }
    workgroupBarrier();
    return sums[0];
}

// ---- light: indexing, shared, light_reduction
// Mean light of the usable pixels, and how many there are: what views are centred on and unknown pixels replaced by.
// This stage sums parts of the picture, `light_sum` the parts.

in image: array<f32>;  // (H, W, 3)
out parts: array<f32>;  // (groups, 4)

@workgroup_size(256)
fn main(group, local) {
    var own = vec4f();
    for (var i = group.x * 256u + local; i < pixels; i += part_count * 256u) {
        let rgb = vec3f(image[3u * i], image[3u * i + 1u], image[3u * i + 2u]);
        if (is_finite(rgb.x) && is_finite(rgb.y) && is_finite(rgb.z) && max(max(rgb.x, rgb.y), rgb.z) < saturation) {
            own += vec4f(rgb, 1.0);
        }
    }
    let total = summed(own, local);
    if (local == 0u) {
        for (var c = 0u; c < 4u; c++) { parts[4u * group.x + c] = total[c]; }
    }
}

// ---- light_sum: indexing, shared, light_reduction
// Sums the parts that `light` left up, to the first numbers of `stats`.

in parts: array<f32>;  // (groups, 4)
out stats: array<f32>;

@workgroup_size(256)
fn main(local) {
    var own = vec4f();
    for (var i = local; i < part_count; i += 256u) {
        own += vec4f(parts[4u * i], parts[4u * i + 1u], parts[4u * i + 2u], parts[4u * i + 3u]);
    }
    let total = summed(own, local);
    if (local == 0u) {
        let mean = total.xyz / max(total.w, 1.0);
        for (var c = 0u; c < 3u; c++) { stats[MEAN_RED + c] = mean[c]; }
        stats[MEAN_ALL] = (mean.x + mean.y + mean.z) / 3.0;
        stats[USABLE] = total.w;
        stats[UNUSABLE] = f32(pixels) - total.w;
        // The power of two that is 2^-light_bits to half of it of the mean light (`integer_light.light_unit`).
        let light = dot(vec3f(guide_rgb[0], guide_rgb[1], guide_rgb[2]), mean);
        let exponent = select(least_exponent, i32(bitcast<u32>(light) >> 23u) - 127i, light > 0.0);
        let place = u32(max(exponent, least_exponent) - i32(light_bits) + 127i);
        stats[UNIT] = bitcast<f32>(place << 23u);
        stats[UNIT + 1u] = bitcast<f32>((254u - place) << 23u);
    }
}

// ---- mixing
// A pixel's light as the views and the guide see it; used by `views` and `halve_rows`. Where `whole`, views
// are in whole units of light, and their mean in an even number of them, so that halves are rounded as without it.

struct Pixel {
    views: vec3f,  // centred on the mean light of the usable pixels
    guide: f32,
    usable: f32,
}

fn pixel(x: u32, y: u32) -> Pixel {
    let at = 3u * (y * width + x);
    var rgb = vec3f(image[at], image[at + 1u], image[at + 2u]);
    let finite = is_finite(rgb.x) && is_finite(rgb.y) && is_finite(rgb.z);
    let usable = finite && max(max(rgb.x, rgb.y), rgb.z) < saturation;
    if (!finite) { rgb = vec3f(stats[MEAN_ALL]); }
    let mean = vec3f(stats[MEAN_RED], stats[MEAN_RED + 1u], stats[MEAN_RED + 2u]);
    var views = vec3f();
    for (var k = 0u; k < view_count; k++) {
        let row = vec3f(rows[3u * k], rows[3u * k + 1u], rows[3u * k + 2u]);
        if (whole) {
            let even = 2.0 * round(0.5 * stats[UNIT + 1u] * dot(row, mean));
            views[k] = stats[UNIT] * (round(stats[UNIT + 1u] * dot(row, rgb)) - even);
        } else {
            views[k] = dot(row, rgb - mean);
        }
    }
    return Pixel(views, dot(vec3f(guide_rgb[0], guide_rgb[1], guide_rgb[2]), rgb), select(0.0, 1.0, usable));
}

// ---- views: indexing, shared, mixing
// Views, guide and mask at full resolution (quality "paper"), as planes.

in image: array<f32>;  // (H, W, 3)
in stats: array<f32>;
out planes: array<f32>;  // (K + 2, H, W): views, guide
out smoothed: array<f32>;  // (K + 2, H, W), of which only the mask

fn main(i) {
    if (i >= width * height) { return; }
    let found = pixel(i % width, i / width);
    for (var k = 0u; k < view_count; k++) { planes[k * width * height + i] = found.views[k]; }
    planes[view_count * width * height + i] = found.guide;
    smoothed[(view_count + 1u) * width * height + i] = found.usable;
}

// ---- halve_rows: indexing, shared, mixing
// Views, guide and mask, every second column of the picture behind OpenCV's pyramid filter (1, 4, 6, 4, 1) / 16.
// Unusable pixels count 0, which is the mean of the views. The guide at full resolution goes out beside them. One
// invocation takes four neighbours, whose pixels overlap.

in image: array<f32>;  // (H, W, 3)
in stats: array<f32>;
out planes: array<f32>;  // (K + 2, H, w): views, guide, mask
out full_guide: array<f32>;  // (H, W)

struct Seen {
    views: vec3f,
    others: vec2f,  // guide, usable share
}

fn seen(x: i32, y: u32) -> Seen {
    let found = pixel(mirrored(x, width), y);
    return Seen(found.usable * found.views, vec2f(found.guide, found.usable));
}

fn main(i) {
    let each = (half_width + 3u) / 4u;  // invocations of a row
    if (i >= each * height) { return; }
    let first = 4u * (i % each);
    let y = i / each;
    let plane = half_width * height;
    var a = seen(2i * i32(first) - 2i, y);
    var b = seen(2i * i32(first) - 1i, y);
    var c = seen(2i * i32(first), y);
    for (var x = first; x < min(first + 4u, half_width); x++) {
        let d = seen(2i * i32(x) + 1i, y);
        let e = seen(2i * i32(x) + 2i, y);
        let views = 0.0625 * a.views + 0.25 * b.views + 0.375 * c.views + 0.25 * d.views + 0.0625 * e.views;
        let others = 0.0625 * a.others + 0.25 * b.others + 0.375 * c.others + 0.25 * d.others + 0.0625 * e.others;
        let at = y * half_width + x;
        for (var k = 0u; k < view_count; k++) { planes[k * plane + at] = views[k]; }
        planes[view_count * plane + at] = others.x;
        planes[(view_count + 1u) * plane + at] = others.y;
        full_guide[y * width + 2u * x] = c.others.x;
        if (2u * x + 1u < width) { full_guide[y * width + 2u * x + 1u] = d.others.x; }
        a = c;
        b = d;
        c = e;
    }
}

// ---- halve_columns: indexing, shared
// Every second row of the planes behind the pyramid filter; views in whole units of light. One invocation takes four neighbours, whose rows overlap.

in tall: array<f32>;  // (planes, H, w)
in stats: array<f32>;
out planes: array<f32>;  // (planes, h, w)

fn main(i) {
    let each = (height + 3u) / 4u;  // invocations of a column
    if (i >= plane_count * each * width) { return; }
    let x = i % width;
    let first = 4u * ((i / width) % each);
    let plane = i / (width * each);
    let column = plane * tall_height * width + x;
    let is_view = plane < view_count;
    var a = tall[column + mirrored(2i * i32(first) - 2i, tall_height) * width];
    var b = tall[column + mirrored(2i * i32(first) - 1i, tall_height) * width];
    var c = tall[column + mirrored(2i * i32(first), tall_height) * width];
    for (var y = first; y < min(first + 4u, height); y++) {
        let d = tall[column + mirrored(2i * i32(y) + 1i, tall_height) * width];
        let e = tall[column + mirrored(2i * i32(y) + 2i, tall_height) * width];
        let sum = 0.0625 * a + 0.25 * b + 0.375 * c + 0.25 * d + 0.0625 * e;
        planes[(plane * height + y) * width + x] = select(sum, stats[UNIT] * round(stats[UNIT + 1u] * sum), is_view);
        a = c;
        b = d;
        c = e;
    }
}

// ---- unusable: indexing, shared
// Which columns of which bands of the halved picture have unusable pixels.

in planes: array<f32>;  // (K + 2, h, w): views, guide, usable share
out unusable: array<u32>;  // (bands, w)

fn main(i) {
    if (i >= band_count * width) { return; }
    let first = (i / width) * band_height;
    var found = 0u;
    for (var y = first; y < min(first + band_height, height); y++) {
        if (planes[(view_count + 1u) * width * height + y * width + i % width] <= usable_share) { found = 1u; }
    }
    unusable[i] = found;
}

// ---- blur: indexing, shared
// Gaussian along one axis, of some planes of one array into the same planes of another. Where `sparse`, only what
// `fill` reads, at unusable pixels, and what that is made of: columns next to unusable pixels. One invocation takes
// four neighbours along the axis, whose pixels overlap. Where `whole`, the sums are rounded to whole units of light.

in before: array<f32>;  // (planes, h, w)
in unusable: array<u32>;  // (bands, w): 1 where a column of a band has one
in stats: array<f32>;
out after: array<f32>;  // (planes, h, w)

fn is_needed(x: u32, y: u32) -> bool {
    let band = y / band_height;  // a band is as high as the Gaussian reaches
    let above = unusable[max(band, 1u) * width - width + x];
    let below = unusable[min(band + 1u, band_count - 1u) * width + x];
    return (above | unusable[band * width + x] | below) != 0u;
}

fn pixel_at(base: u32, place: i32, length: u32, stride: u32) -> f32 {
    return before[base + select(mirrored(place, length), inside(place, length), replicate) * stride];
}

fn main(i) {
    let length = select(height, width, along_x);
    let each = (length + 3u) / 4u;  // invocations of a line
    if (i >= each * select(width, height, along_x)) { return; }
    // Along y neighbours in memory are neighbouring lines.
    let line = select(i % width, i / each, along_x);
    let first = 4u * select(i / width, i % each, along_x);
    let stride = select(width, 1u, along_x);
    let start = select(line, line * width, along_x);
    if (sparse) {
        var needed = false;
        for (var j = first; j < min(first + 4u, length); j++) {
            needed = needed || is_needed(select(line, j, along_x), select(j, line, along_x));
        }
        if (!needed) { return; }
    }
    for (var plane = first_plane; plane < first_plane + plane_count; plane++) {
        let base = plane * width * height + start;
        var sums = sums_of(base, i32(first) - i32(reach), length, stride);
        if (whole) { sums = stats[UNIT] * round(stats[UNIT + 1u] * sums); }
        for (var j = 0u; j < min(4u, length - first); j++) { after[base + (first + j) * stride] = sums[j]; }
    }
}

// ---- blur_short
// `blur` with weights that are constants: `taps`, of a pixel in the sums of four neighbours.
fn sums_of(base: u32, first: i32, length: u32, stride: u32) -> vec4f {
    var sums = vec4f();
    for (var j = 0u; j < span; j++) {  // unrolled
        let weights = vec4f(taps[4u * j], taps[4u * j + 1u], taps[4u * j + 2u], taps[4u * j + 3u]);
        sums += weights * pixel_at(base, first + i32(j), length, stride);
    }
    return sums;
}

// ---- blur_long
// `blur` with weights that are read: many.
@group(0) @binding(4) var<storage, read> taps: array<vec4f>;  // of a pixel in the sums of four neighbours

fn sums_of(base: u32, first: i32, length: u32, stride: u32) -> vec4f {
    var sums = vec4f();
    for (var j = 0u; j < span; j++) { sums += taps[j] * pixel_at(base, first + i32(j), length, stride); }
    return sums;
}

// ---- fill: indexing, shared
// Replace unusable pixels of the halved views by the mean of the usable ones around: their edges would outweigh all
// texture. The plane behind the guide holds the usable share of each pixel, of which the mask is made.

in around: array<f32>;  // (K + 2, h, w), blurred where there are unusable pixels
in stats: array<f32>;
out planes: array<f32>;  // (K + 2, h, w): views, guide, usable share
out smoothed: array<f32>;  // (K + 2, h, w), of which only the mask

fn main(i) {
    if (i >= plane) { return; }
    let share = (view_count + 1u) * plane + i;
    let usable = planes[share] > usable_share;
    if (!usable) {
        for (var k = 0u; k < view_count; k++) {
            let mean = around[k * plane + i] / (around[share] + 1.0e-3);  // 1e-3: no division by 0
            planes[k * plane + i] = fill_units * stats[UNIT] * round(stats[UNIT + 1u] * mean / fill_units);
        }
    }
    smoothed[share] = select(0.0, 1.0, usable);
}

// ---- moved_views: indexing, shared
// Views sampled where the lens shows them, between four pixels each, in whole units of light: weights are whole parts, so
// that sums are exact. See `matching/integer_light.py`.

in planes: array<f32>;  // (at least K, h, w)
in moves: array<u32>;  // (K, h, w): parts of a px along x and y, 16 bits each
in stats: array<f32>;
out sampled: array<f32>;  // (K, h, w)

fn main(i) {
    if (i >= view_count * width * height) { return; }
    let pixel = i % (width * height);
    let both = bitcast<i32>(moves[i]);
    let parts = i32(move_parts);
    let place = parts * vec2i(i32(pixel % width), i32(pixel / width)) + vec2i((both << 16u) >> 16u, both >> 16u);
    let first = vec2i(floor(vec2f(place) / f32(parts)));
    let part = vec2f(place - parts * first);
    let base = i - pixel;
    let upper = base + inside(first.y, height) * width;
    let lower = base + inside(first.y + 1i, height) * width;
    let left = inside(first.x, width);
    let right = inside(first.x + 1i, width);
    let rest = f32(parts) - part;
    let sum = rest.y * (rest.x * planes[upper + left] + part.x * planes[upper + right])
        + part.y * (rest.x * planes[lower + left] + part.x * planes[lower + right]);
    sampled[i] = stats[UNIT] * round(stats[UNIT + 1u] * (sum / f32(parts * parts)));
}

// ---- variance_reduction
// Sums over a workgroup, for `variance` and `variance_sum`.

struct Sums {
    values: vec3f,
    squares: vec3f,
}

var<workgroup> sums: array<Sums, 256>;

fn summed(own: Sums, local: u32) -> Sums {
    sums[local] = own;
    for (var reach = 128u; reach > 0u; reach /= 2u) {
        workgroupBarrier();
        if (local < reach) {
            sums[local].values += sums[local + reach].values;
            sums[local].squares += sums[local + reach].squares;
        }
    }
    workgroupBarrier();
    return sums[0];
}

// ---- variance: indexing, shared, variance_reduction
// Variance of every view over the picture. This stage sums parts of it, `variance_sum` the parts.

in planes: array<f32>;  // (planes, h, w), the views first
out parts: array<f32>;  // (groups, 6)

@workgroup_size(256)
fn main(group, local) {
    var own = Sums();
    for (var i = group.x * 256u + local; i < pixels; i += part_count * 256u) {
        for (var k = 0u; k < view_count; k++) {  // unrolled
            let value = planes[k * pixels + i];
            own.values[k] += value;
            own.squares[k] += value * value;
        }
    }
    let total = summed(own, local);
    if (local == 0u) {
        for (var k = 0u; k < 3u; k++) {
            parts[6u * group.x + k] = total.values[k];
            parts[6u * group.x + 3u + k] = total.squares[k];
        }
    }
}

// ---- variance_sum: indexing, shared, variance_reduction
// Sums the parts that `variance` left up, to the views' variances.

in parts: array<f32>;  // (groups, 6)
out stats: array<f32>;

@workgroup_size(256)
fn main(local) {
    var own = Sums();
    for (var i = local; i < part_count; i += 256u) {
        own.values += vec3f(parts[6u * i], parts[6u * i + 1u], parts[6u * i + 2u]);
        own.squares += vec3f(parts[6u * i + 3u], parts[6u * i + 4u], parts[6u * i + 5u]);
    }
    let total = summed(own, local);
    if (local == 0u) {
        let mean = total.values / f32(pixels);
        let variance = max(total.squares / f32(pixels) - mean * mean, vec3f());
        // Half a unit of light is rounding (`views.constant_variance`).
        let least = select(0.0, 0.25 * stats[UNIT] * stats[UNIT], whole);
        for (var k = 0u; k < 3u; k++) { stats[VARIANCE + k] = select(variance[k], 0.0, variance[k] <= least); }
    }
}

// ---- guide_scale: indexing, shared
// The factor that brings a guide to units of guide_range: its 1st and 99th percentile over a sparse grid.
// One workgroup finds the values of the four ranks by their bits, eight at a time (radix selection): all four in one walk
// over the samples, which are read `at_once` at a time, as one after the other waits for the memory.

in planes: array<f32>;
out stats: array<f32>;

var<workgroup> counts: array<atomic<u32>, 1024>;  // of the four ranks, one after the other
var<workgroup> prefixes: array<u32, 4>;  // bits found so far
var<workgroup> ranks_left: array<u32, 4>;  // among the values that begin with them
var<workgroup> homes: array<u32, 4>;  // first rank whose value begins with the same bits: it counts for all of them

// Floats in the order of unsigned integers.
fn ordered(value: f32) -> u32 {
    let bits = bitcast<u32>(value);
    return select(bits | 0x80000000u, ~bits, (bits & 0x80000000u) != 0u);
}

fn value_of(ordered_bits: u32) -> f32 {
    return bitcast<f32>(select(~ordered_bits, ordered_bits & 0x7fffffffu, (ordered_bits & 0x80000000u) != 0u));
}

fn sample(i: u32) -> u32 {
    return ordered(planes[first + (i / sparse_width) * sparse * width + (i % sparse_width) * sparse]);
}

fn percentile(place: f32, rank: u32) -> f32 {
    let low = value_of(prefixes[rank]);
    return low + (place - floor(place)) * (value_of(prefixes[rank + 1u]) - low);
}

@workgroup_size(256)
fn main(local) {
    if (local < 4u) {
        let below = u32(floor(select(low_place, high_place, local > 1u)));
        prefixes[local] = 0u;
        homes[local] = 0u;
        ranks_left[local] = min(below + (local & 1u), sparse_count - 1u);
    }
    for (var shift = 24i; shift >= 0i; shift -= 8i) {
        for (var rank = 0u; rank < 4u; rank++) { atomicStore(&counts[rank * 256u + local], 0u); }
        workgroupBarrier();
        for (var i = local; i < sparse_count; i += 256u * at_once) {
            var bits: array<u32, at_once>;
            for (var n = 0u; n < at_once; n++) {  // unrolled
                bits[n] = sample(min(i + n * 256u, sparse_count - 1u));
            }
            for (var n = 0u; n < at_once; n++) {  // unrolled
                for (var rank = 0u; rank < 4u; rank++) {
                    let same = shift == 24i || (bits[n] >> u32(shift + 8i)) == (prefixes[rank] >> u32(shift + 8i));
                    if (same && homes[rank] == rank && i + n * 256u < sparse_count) {
                        atomicAdd(&counts[rank * 256u + ((bits[n] >> u32(shift)) & 255u)], 1u);
                    }
                }
            }
        }
        workgroupBarrier();
        if (local < 4u) {
            var left = ranks_left[local];
            var digit = 0u;
            for (; digit < 255u; digit++) {
                let here = atomicLoad(&counts[homes[local] * 256u + digit]);
                if (left < here) { break; }
                left -= here;
            }
            ranks_left[local] = left;
            prefixes[local] |= digit << u32(shift);
        }
        workgroupBarrier();
        if (local < 4u) {
            var home = 0u;
            while (prefixes[home] != prefixes[local]) { home++; }
            homes[local] = home;
        }
        workgroupBarrier();
    }
    if (local == 0u) {
        let low = percentile(low_place, 0u);
        let high = percentile(high_place, 2u);
        stats[GUIDE_SCALE + slot] = 1.0 / (max(high - low, 1.0e-6) * guide_range);  // 1e-6: an even guide
    }
}

// ---- two_views: indexing, shared
// Where fewer than two of the matched channels hold light: means of squares of the picture, from four pixels of each.

in image: array<f32>;  // (H, W, 3)
out lacking: array<f32>;  // (cells_y, cells_x): 1 or 0

const matched = array<f32, 3>(matched_red, matched_green, matched_blue);

fn main(i) {
    if (i >= cells_x * cells_y) { return; }
    // A cell covers so many of the sparse samples, those at its borders in part.
    let left = f32(i % cells_x) * per_cell_x;
    let top = f32(i / cells_x) * per_cell_y;
    var lit = 0u;
    for (var c = 0u; c < 3u; c++) {
        var sum = 0.0;
        var unknown = false;
        for (var y = u32(top); y < min(u32(ceil(top + per_cell_y)), samples_y); y++) {
            for (var x = u32(left); x < min(u32(ceil(left + per_cell_x)), samples_x); x++) {
                let value = image[3u * ((first_y + y * spacing) * width + first_x + x * spacing) + c];
                let across = min(f32(x) + 1.0, left + per_cell_x) - max(f32(x), left);
                let down = min(f32(y) + 1.0, top + per_cell_y) - max(f32(y), top);
                if (is_finite(value)) { sum += across * down * value; } else { unknown = true; }
            }
        }
        // What is not finite is not known to be dark.
        if (matched[c] > 0.0 && (unknown || sum / (per_cell_x * per_cell_y) >= dark)) { lit++; }
    }
    lacking[i] = select(0.0, 1.0, lit < 2u);
}
