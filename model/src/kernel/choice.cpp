// Picks the kernel once, at first use.
#include <cstdlib>
#include <cstring>

#include "ctr/kernel.hpp"

namespace ctr {
namespace {

bool use_avx2() {
#ifdef CTR_HAVE_AVX2
    const char* forced = std::getenv("CTRPLAN_KERNEL");
    if (forced && std::strcmp(forced, "baseline") == 0) return false;
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
#else
    return false;
#endif
}

}  // namespace

const KernelTable& kernel(int lanes) {
#ifdef CTR_HAVE_AVX2
    static const bool wide = use_avx2();
    if (wide) return avx2_kernel(lanes);
#endif
    return baseline_kernel(lanes);
}

const char* kernel_name() {
    static const bool wide = use_avx2();
    return wide ? "avx2" : "baseline";
}

}  // namespace ctr
