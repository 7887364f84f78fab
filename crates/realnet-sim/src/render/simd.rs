//! Which vector instructions the pixel loops may use.

/// A set of vector instructions that was found on this processor. The loops are
/// compiled once for each; all of them return the same bits, as none may contract
/// a product and a sum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Simd {
    /// What the compilation target guarantees.
    Portable,
    /// AVX2.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// AVX-512 F, BW, VL and DQ.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Simd {
    /// The widest set this processor has.
    pub(crate) fn best() -> Self {
        Self::found().last().copied().unwrap_or(Self::Portable)
    }

    /// The sets this processor has, the widest last.
    pub(crate) fn found() -> &'static [Self] {
        #[cfg(target_arch = "x86_64")]
        {
            let avx2 = is_x86_feature_detected!("avx2");
            let avx512 = avx2
                && is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512bw")
                && is_x86_feature_detected!("avx512vl")
                && is_x86_feature_detected!("avx512dq");
            match (avx2, avx512) {
                (_, true) => &[Self::Portable, Self::Avx2, Self::Avx512],
                (true, _) => &[Self::Portable, Self::Avx2],
                _ => &[Self::Portable],
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        &[Self::Portable]
    }
}

/// Defines `fn name(simd: Simd, …)` whose body is compiled once for every
/// instruction set, for the compiler to vectorise. What it calls has to be
/// `#[inline(always)]`.
macro_rules! multiversion {
    ($(#[$meta:meta])* $vis:vis fn $name:ident($($arg:ident: $ty:ty),* $(,)?) $body:block) => {
        $(#[$meta])*
        #[allow(clippy::too_many_arguments)]
        $vis fn $name(simd: $crate::render::simd::Simd, $($arg: $ty),*) {
            #[inline(always)]
            fn portable($($arg: $ty),*) $body

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2")]
            fn avx2($($arg: $ty),*) { portable($($arg),*) }

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512dq")]
            fn avx512($($arg: $ty),*) { portable($($arg),*) }

            match simd {
                $crate::render::simd::Simd::Portable => portable($($arg),*),
                // SAFETY: a `Simd` other than `Portable` comes from `Simd::found`.
                #[cfg(target_arch = "x86_64")]
                $crate::render::simd::Simd::Avx2 => unsafe { avx2($($arg),*) },
                // SAFETY: as above.
                #[cfg(target_arch = "x86_64")]
                $crate::render::simd::Simd::Avx512 => unsafe { avx512($($arg),*) },
            }
        }
    };
}
pub(crate) use multiversion;
