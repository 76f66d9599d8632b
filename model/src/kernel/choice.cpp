// Picks the kernels once, at first use.
#include <cstdlib>
#include <cstring>

#include "ctr/kernel.hpp"

namespace ctr {
namespace {

enum Width { baseline, avx2, avx512 };

Width widest() {
#ifdef CTR_HAVE_AVX2
    const char* forced = std::getenv("CTRPLAN_KERNEL");
    const auto may = [&](const char* name) { return !forced || std::strcmp(forced, name) != 0; };
    if (!may("baseline") || !__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma")) return baseline;
    const bool is_wide = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
    return may("avx2") && is_wide ? avx512 : avx2;
#else
    return baseline;
#endif
}

Width width() {
    static const Width chosen = widest();
    return chosen;
}

}  // namespace

const KernelTable& kernel(int lanes) {
#ifdef CTR_HAVE_AVX2
    if (lanes > kLanes) return avx512_kernel();
    if (width() != baseline) return avx2_kernel(lanes);
#endif
    return baseline_kernel(lanes);
}

int lanes_for(std::size_t states) { return width() == avx512 && states > kLanes ? kMostLanes : kLanes; }

const char* kernel_name() {
    constexpr const char* names[] = {"baseline", "avx2", "avx512"};
    return names[width()];
}

}  // namespace ctr
