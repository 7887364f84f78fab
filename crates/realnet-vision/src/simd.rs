//! Which vector instructions a kernel may use, here and in other rooms with loops over pixels.

/// A set of vector instructions that was found on this processor.
///
/// Kernels marked with [`multiversion`] are one source compiled for each set;
/// the rest have hand-written code. All of them return the same bits. On
/// aarch64 the portable code is compiled with NEON, which every such processor
/// has.
///
/// The sets beyond [`Simd::Portable`] come from [`Simd::found`] alone: elsewhere they
/// cannot be made, so that code for them never runs where it must not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Simd {
    /// What the compilation target guarantees.
    Portable,
    /// AVX2.
    #[cfg(target_arch = "x86_64")]
    #[non_exhaustive]
    Avx2,
    /// AVX-512 F, BW, VL, DQ and VNNI.
    #[cfg(target_arch = "x86_64")]
    #[non_exhaustive]
    Avx512,
}

impl Simd {
    /// The widest set this processor has.
    #[must_use]
    pub fn best() -> Self {
        Self::found().last().copied().unwrap_or(Self::Portable)
    }

    /// The sets this processor has, the widest last.
    #[must_use]
    pub fn found() -> &'static [Self] {
        #[cfg(target_arch = "x86_64")]
        {
            let avx2 = is_x86_feature_detected!("avx2");
            let avx512 = avx2
                && is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512bw")
                && is_x86_feature_detected!("avx512vl")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512vnni");
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
/// instruction set, for the compiler to vectorise.
///
/// Inner loops must not call what may not be inlined: `array::map`, for one,
/// stays a function of its own, compiled without the instruction set. What is called
/// has to be `#[inline(always)]`.
#[macro_export]
#[doc(hidden)]
macro_rules! multiversion {
    ($(#[$meta:meta])* $vis:vis fn $name:ident($($arg:ident: $ty:ty),* $(,)?) $(-> $ret:ty)? $body:block) => {
        $(#[$meta])*
        #[allow(clippy::too_many_arguments)]
        $vis fn $name(simd: $crate::simd::Simd, $($arg: $ty),*) $(-> $ret)? {
            #[inline(always)]
            fn portable($($arg: $ty),*) $(-> $ret)? $body

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2")]
            fn avx2($($arg: $ty),*) $(-> $ret)? { portable($($arg),*) }

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512dq")]
            fn avx512($($arg: $ty),*) $(-> $ret)? { portable($($arg),*) }

            match simd {
                $crate::simd::Simd::Portable => portable($($arg),*),
                // SAFETY: a `Simd` other than `Portable` comes from `Simd::found`.
                #[cfg(target_arch = "x86_64")]
                $crate::simd::Simd::Avx2 { .. } => unsafe { avx2($($arg),*) },
                // SAFETY: as above.
                #[cfg(target_arch = "x86_64")]
                $crate::simd::Simd::Avx512 { .. } => unsafe { avx512($($arg),*) },
            }
        }
    };
}
pub use multiversion;
