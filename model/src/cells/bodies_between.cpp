// Bodies in friction states from those of configurations on both sides.
#include <cmath>

#include "ctr/friction_cells.hpp"

namespace ctr {
namespace {

double length(const Vec3& v) { return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

double length_between(const double* a, const double* b) { return length({a[0] - b[0], a[1] - b[1], a[2] - b[2]}); }

// Shares of the whole length at the points of a body.
std::vector<double> shares_of_length(const CornerBodies& own) {
    std::vector<double> share(own.points, 0.0);
    for (std::size_t k = 1; k < own.points; ++k) share[k] = share[k - 1] + length_between(own.at(0, k), own.at(0, k - 1));
    for (double& one : share) one /= share.back();
    return share;
}

// Multilinear weights of the corners.
std::vector<double> weights_at(const double* phi, int pairs) {
    std::vector<double> weights{1.0};
    for (int pair = 0; pair < pairs; ++pair) {
        std::vector<double> finer;
        for (double weight : weights)
            for (double sign : {1.0, -1.0}) finer.push_back(weight * ((1 + phi[pair] * sign) / 2));
        weights = std::move(finer);
    }
    return weights;
}

// Where wanted shares of the length lie among those of a bend.
struct Place {
    std::size_t after;
    double part;
};

std::vector<Place> places(const std::vector<double>& wanted, const Bend& bend) {
    std::vector<Place> found;
    found.reserve(wanted.size());
    std::size_t after = 1;
    for (double share : wanted) {
        while (after + 1 < bend.points && bend.share[after] < share) ++after;
        found.push_back({after, (share - bend.share[after - 1]) / (bend.share[after] - bend.share[after - 1])});
    }
    return found;
}

Vec3 moved(const Bend& bend, std::size_t state, const Place& place) {
    const double* high = bend.values + 3 * (state * bend.points + place.after);
    const double* low = high - 3;
    Vec3 value;
    for (int i = 0; i < 3; ++i) value[i] = low[i] * (1 - place.part) + high[i] * place.part;
    return value;
}

// From the base up to `beyond` points further out, the largest; not a number beyond one that is none.
void spread_outwards(double* doubt, std::size_t points, std::size_t beyond) {
    for (std::size_t k = 1; k < points; ++k)
        if (!(doubt[k] > doubt[k - 1] || std::isnan(doubt[k]))) doubt[k] = doubt[k - 1];
    for (std::size_t k = 0; k < points; ++k) doubt[k] = doubt[std::min(k + beyond, points - 1)];
}

}  // namespace

BodiesBetween bodies_between(const CornerBodies& own, const double* phi, std::size_t states, const Bend& first, const Bend& last, double share,
                             const Doubts& doubts) {
    const std::size_t points = own.points, corners = std::size_t{1} << own.pairs;
    const std::vector<double> wanted = shares_of_length(own);
    const std::vector<Place> in_first = places(wanted, first), in_last = places(wanted, last);
    std::vector<double> spread(points, 0.0);
    for (std::size_t k = 0; k < points; ++k)
        for (std::size_t corner = 1; corner <= corners; ++corner) spread[k] = std::fmax(spread[k], length_between(own.at(corner, k), own.at(0, k)));
    BodiesBetween found{std::vector<double>(states * points * 3), std::vector<double>(states * points)};
    for (std::size_t state = 0; state < states; ++state) {
        const std::vector<double> weights = weights_at(phi + state * own.pairs, own.pairs);
        double* doubt = found.doubt.data() + state * points;
        for (std::size_t k = 0; k < points; ++k) {
            const Vec3 before = moved(first, state, in_first[k]), behind = moved(last, state, in_last[k]);
            Vec3 bend, change;
            for (int i = 0; i < 3; ++i) {
                bend[i] = (1 - share) * before[i] + share * behind[i];
                change[i] = before[i] - behind[i];
            }
            double* body = found.bodies.data() + 3 * (state * points + k);
            for (std::size_t corner = 0; corner < corners; ++corner)
                for (int i = 0; i < 3; ++i) body[i] += weights[corner] * own.at(corner + 1, k)[i];
            for (int i = 0; i < 3; ++i) body[i] += bend[i];
            doubt[k] = doubts.change * length(change) + doubts.bend * length(bend) + doubts.spread * spread[k];
        }
        spread_outwards(doubt, points, doubts.beyond);
    }
    return found;
}

}  // namespace ctr
