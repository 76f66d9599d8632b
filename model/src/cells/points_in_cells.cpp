#include <algorithm>
#include <cmath>
#include <limits>

#include "ctr/friction_cells.hpp"
#include "ctr/robot.hpp"
#include "ctr/watch.hpp"

namespace ctr {
namespace {

// Of one part at once, a budget: whoever halves the cell spends less. Where clearances are alike in many states of P pairs, as many
// boxes as the inverse of their length to the power of P / 2 stay open.
constexpr std::size_t kMostBoxes = 16384;

}  // namespace

double clearance_beside(double clearance, double half) {
    return clearance > half ? std::sqrt(clearance * clearance - half * half) : clearance - half;
}

PointsInCells::PointsInCells(const CellBodies& bodies, const Asked& asked, const double* error, const double* enough)
    : pairs_(0), corner_count_(bodies.corners), half_(asked.half), within_(asked.within) {
    while (1 << pairs_ < bodies.corners) ++pairs_;
    if (1 << pairs_ != bodies.corners || bodies.points == 0) throw InvalidInput("a cell has 2^P corners, whose bodies have points");
    if (asked.parts != 1 && (asked.parts < 2 || asked.parts % 2)) throw InvalidInput("a body is looked at in one part or in an even number of them");
    if (!(asked.within > 0)) throw InvalidInput("boxes of states are halved to a length");
    const std::size_t all = bodies.cells * bodies.points, parts = asked.parts * asked.count;
    for (std::size_t k = 0; k < asked.count; ++k)
        if (asked.point[k] < 0 || static_cast<std::size_t>(asked.point[k]) >= all) throw InvalidInput("a point is asked for that no cell has");
    error_.resize(parts), enough_.resize(parts);
    for (std::size_t part = 0; part < parts; ++part) {
        const std::size_t point = asked.point[part % asked.count];
        error_[part] = error[point];
        enough_[part] = enough[point / bodies.points];
    }
    gather(bodies, asked);
    measure_moves();
    least_.assign(parts, std::numeric_limits<double>::infinity());
    at_.assign(parts * pairs_, 0.5);
    place_.assign(parts, Vec3{0, 0, 0});
    index_.resize(parts);
    for (std::size_t part = 0; part < parts; ++part) index_[part] = part;
    low_.assign(parts * pairs_, 0.0), size_.assign(parts * pairs_, 1.0);
    ask();
}

// Each part stands in the middle of its piece of the body between a point and the one before it, then the one after it.
void PointsInCells::gather(const CellBodies& bodies, const Asked& asked) {
    corners_.resize(4 * asked.parts * asked.count * corner_count_);
    double* to = corners_.data();
    for (int part = 0; part < asked.parts; ++part) {
        const int half = asked.parts / 2;
        const double share = asked.parts == 1 ? 0 : (part % half + 0.5) / asked.parts;
        for (std::size_t k = 0; k < asked.count; ++k) {
            const std::size_t cell = asked.point[k] / bodies.points, at = asked.point[k] % bodies.points;
            const std::size_t beside = part < half ? (at == 0 ? at : at - 1) : std::min(at + 1, bodies.points - 1);
            for (int c = 0; c < corner_count_; ++c) {
                const double *own = bodies.point(cell, c, at), *other = bodies.point(cell, c, beside);
                for (int i = 0; i < 4; ++i) *to++ = own[i] + share * (other[i] - own[i]);
            }
        }
    }
}

// How far a part's surface can move over its cell by each pair: the longest edges, radii counted. And by how much several pairs
// together move a point otherwise than one by one: the largest mixed difference of every two pairs and more.
void PointsInCells::measure_moves() {
    const std::size_t parts = error_.size();
    moves_.assign(parts * pairs_, 0.0), turns_.assign(parts * pairs_, 0.0), mixed_.assign(parts * corner_count_, 0.0);
    std::vector<double> differences(4 * corner_count_);
    for (std::size_t part = 0; part < parts; ++part) {
        for (int pair = 0; pair < pairs_; ++pair) {
            const int high = 1 << (pairs_ - 1 - pair);
            double &most = moves_[part * pairs_ + pair], &wider = turns_[part * pairs_ + pair];
            for (int c = 0; c < corner_count_; ++c) {
                if (c & high) continue;
                const double *a = corner(part, c), *b = corner(part, c | high);
                const double x = b[0] - a[0], y = b[1] - a[1], z = b[2] - a[2];
                most = std::max(most, std::sqrt(x * x + y * y + z * z) + std::fabs(b[3] - a[3]));
                wider = std::max(wider, std::fabs(b[3] - a[3]));
            }
        }
        for (int pairs = 0; pairs < corner_count_; ++pairs) {  // a bit for each
            if ((pairs & (pairs - 1)) == 0) continue;          // one pair alone
            std::copy_n(corner(part, 0), 4 * corner_count_, differences.begin());
            for (int high = 1; high < corner_count_; high <<= 1)
                for (int c = 0; pairs & high && c < corner_count_; ++c)
                    for (int i = 0; !(c & high) && i < 3; ++i) differences[4 * c + i] = differences[4 * (c | high) + i] - differences[4 * c + i];
            double& most = mixed_[part * corner_count_ + pairs];
            for (int c = 0; c < corner_count_; ++c)
                if (!(c & pairs)) most = std::max(most, std::hypot(differences[4 * c], differences[4 * c + 1], differences[4 * c + 2]));
        }
    }
}

void PointsInCells::ask() {
    const std::size_t boxes = index_.size();
    points_.resize(boxes), radius_.resize(boxes), slack_.resize(boxes), needed_.resize(boxes);
    std::vector<Vec3> slope(pairs_);
    std::vector<std::array<double, 4>> line((pairs_ + 1) * corner_count_);  // points, then slopes by each pair
    for (std::size_t box = 0; box < boxes; ++box) {
        const std::size_t part = index_[box];
        const double *low = low_.data() + box * pairs_, *size = size_.data() + box * pairs_;
        for (int c = 0; c < corner_count_; ++c) std::copy_n(corner(part, c), 4, line[c].begin());
        for (int pair = 0, left = corner_count_ / 2; pair < pairs_; ++pair, left /= 2) {  // linear in one pair after the other
            const double unit = low[pair] + size[pair] / 2;
            for (int c = 0; c < left; ++c)
                for (int i = 0; i < 4; ++i) line[(pair + 1) * corner_count_ + c][i] = size[pair] * (line[c + left][i] - line[c][i]);
            for (int row = 0; row <= pair; ++row)
                for (std::array<double, 4>*to = &line[row * corner_count_], *end = to + left; to < end; ++to)
                    for (int i = 0; i < 4; ++i) (*to)[i] += unit * ((*(to + left))[i] - (*to)[i]);
        }
        for (int pair = 0; pair < pairs_; ++pair) std::copy_n(line[(pair + 1) * corner_count_].begin(), 3, slope[pair].begin());
        points_[box] = {line[0][0], line[0][1], line[0][2]};
        radius_[box] = line[0][3];
        slack_[box] = slack(part, size, slope);
        needed_[box] = enough_[part] + error_[part] + radius_[box] + slack_[box] + half_;
    }
}

// How far a part's surface in a box may be from that in its middle. slope: what each pair moves the point over the box, the others
// in their middle. The farthest vertex by all of them, and what they do together besides; no more than the longest edges say.
double PointsInCells::slack(std::size_t part, const double* size, const std::vector<Vec3>& slope) const {
    double edges = 0, wider = 0, farthest = 0;
    for (int pair = 0; pair < pairs_; ++pair) {
        edges += moves_[part * pairs_ + pair] * size[pair] / 2;
        wider += turns_[part * pairs_ + pair] * size[pair] / 2;
    }
    for (int signs = 0; signs < corner_count_ / 2; ++signs) {  // of a vertex and of the one opposite
        Vec3 moved = slope[0];
        for (int pair = 1; pair < pairs_; ++pair)
            for (int i = 0; i < 3; ++i) moved[i] += signs >> (pair - 1) & 1 ? slope[pair][i] : -slope[pair][i];
        farthest = std::max(farthest, moved[0] * moved[0] + moved[1] * moved[1] + moved[2] * moved[2]);
    }
    farthest = std::sqrt(farthest) / 2;
    for (int pairs = 3; pairs < corner_count_; ++pairs) {
        double together = mixed_[part * corner_count_ + pairs];
        for (int pair = 0; pair < pairs_ && together > 0; ++pair)
            if (pairs >> (pairs_ - 1 - pair) & 1) together *= size[pair] / 2;
        farthest += together;
    }
    return std::min(edges, farthest + wider);
}

void PointsInCells::tell(const double* clearance) {
    Watch::look();
    std::vector<std::size_t> open, count(least_.size(), 0);
    std::vector<double> clear(index_.size());
    for (std::size_t box = 0; box < index_.size(); ++box) {
        const std::size_t part = index_[box];
        clear[box] = clearance_beside(clearance[box], half_) - error_[part] - radius_[box];
        const bool is_enough = clear[box] - slack_[box] >= enough_[part], is_short = !(clear[box] >= enough_[part]);
        if (!is_enough && !is_short && slack_[box] > within_) {
            open.push_back(box);
            ++count[part];
        } else {
            keep_less(box, is_short ? clear[box] : clear[box] - slack_[box]);  // less than asked for says enough
        }
    }
    for (std::size_t box : open)
        if (count[index_[box]] > kMostBoxes) keep_less(box, clear[box] - slack_[box]);
    halve(open);
    ask();
}

void PointsInCells::keep_less(std::size_t box, double found) {
    const std::size_t part = index_[box];
    if (!(found < least_[part])) return;
    least_[part] = found;
    place_[part] = points_[box];
    for (int pair = 0; pair < pairs_; ++pair) at_[part * pairs_ + pair] = low_[box * pairs_ + pair] + size_[box * pairs_ + pair] / 2;
}

// Each along the pair whose states move its part most; none of a part of which less than enough was found.
void PointsInCells::halve(const std::vector<std::size_t>& boxes) {
    std::vector<std::size_t> index;
    std::vector<double> low, size;
    for (std::size_t box : boxes) {
        const std::size_t part = index_[box];
        if (!(least_[part] >= enough_[part])) continue;
        int along = 0;
        double most = -1;
        for (int pair = 0; pair < pairs_; ++pair) {
            const double moves = moves_[part * pairs_ + pair] * size_[box * pairs_ + pair];
            if (moves > most) most = moves, along = pair;
        }
        for (int half = 0; half < 2; ++half) {
            index.push_back(part);
            for (int pair = 0; pair < pairs_; ++pair) {
                const double whole = size_[box * pairs_ + pair], own = pair == along ? whole / 2 : whole;
                low.push_back(low_[box * pairs_ + pair] + (pair == along && half ? own : 0.0));
                size.push_back(own);
            }
        }
    }
    index_.swap(index), low_.swap(low), size_.swap(size);
}

}  // namespace ctr
