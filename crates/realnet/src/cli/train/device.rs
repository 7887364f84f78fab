//! What computes: the processor, or graphics cards of a program that was built for them.

use crate::cli::failure::bad_input;
use anyhow::Result;
use burn::tensor::Device;
#[cfg(any(feature = "cuda", feature = "wgpu"))]
use burn::tensor::DeviceType;
use serde::{Deserialize, Serialize};
use std::{fmt, str::FromStr};

/// A device by kind and number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub(super) enum DeviceFlag {
    /// The processor, all cores.
    Cpu,
    /// An Nvidia card.
    Cuda(usize),
    /// A card by Vulkan, Metal or DirectX.
    Wgpu(usize),
}

impl FromStr for DeviceFlag {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (kind, number) = text.split_once(':').unwrap_or((text, "0"));
        let number = number.parse().map_err(|_| format!("{text:?} has no number after the colon"));
        match kind {
            "cpu" if !text.contains(':') => Ok(Self::Cpu),
            "cuda" => number.map(Self::Cuda),
            "wgpu" => number.map(Self::Wgpu),
            _ => Err(format!("{text:?} is not cpu, cuda, cuda:N, wgpu or wgpu:N")),
        }
    }
}

impl TryFrom<String> for DeviceFlag {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<DeviceFlag> for String {
    fn from(flag: DeviceFlag) -> Self {
        flag.to_string()
    }
}

impl fmt::Display for DeviceFlag {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Cpu => f.write_str("cpu"),
            Self::Cuda(number) => write!(f, "cuda:{number}"),
            Self::Wgpu(number) => write!(f, "wgpu:{number}"),
        }
    }
}

impl DeviceFlag {
    /// The device, ready to differentiate, with its random numbers seeded.
    pub(super) fn start(self, seed: u32) -> Result<Device> {
        let device = match self {
            Self::Cpu => Device::flex(),
            #[cfg(feature = "cuda")]
            Self::Cuda(number) => self.listed(DeviceType::Cuda, number)?,
            #[cfg(feature = "wgpu")]
            Self::Wgpu(number) => self.listed(DeviceType::Wgpu, number)?,
            #[cfg(not(all(feature = "cuda", feature = "wgpu")))]
            _ => {
                let kind = if matches!(self, Self::Cuda(_)) { "cuda" } else { "wgpu" };
                return Err(bad_input(format!(
                    "--device {self}: this program was built without {kind}; cargo install \
                     --path crates/realnet --features train,{kind}"
                )));
            }
        };
        let device = device.autodiff();
        device.seed(u64::from(seed));
        Ok(device)
    }

    #[cfg(any(feature = "cuda", feature = "wgpu"))]
    fn listed(self, kind: DeviceType, number: usize) -> Result<Device> {
        let mut found = Device::enumerate(kind).into_vec();
        if number < found.len() {
            return Ok(found.swap_remove(number));
        }
        let count = found.len();
        Err(bad_input(format!("--device {self}: {count} such devices were found, from number 0")))
    }
}

/// All devices of a run, the first of which holds the network.
pub(super) fn start(flags: &[DeviceFlag], seed: u32) -> Result<(Device, Vec<Device>)> {
    let devices = flags.iter().map(|flag| flag.start(seed)).collect::<Result<Vec<_>>>()?;
    let mut devices = devices.into_iter();
    let first = devices.next().ok_or_else(|| bad_input("--device: none is named"))?;
    Ok((first, devices.collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn devices_by_name() {
        let parsed = |text: &str| text.parse::<DeviceFlag>();
        assert_eq!(parsed("cpu"), Ok(DeviceFlag::Cpu));
        assert_eq!(parsed("cuda"), Ok(DeviceFlag::Cuda(0)));
        assert_eq!(parsed("wgpu:12"), Ok(DeviceFlag::Wgpu(12)));
        for wrong in ["", "gpu", "cpu:1", "cuda:", "cuda:-1", "wgpu:one"] {
            assert!(parsed(wrong).unwrap_err().contains(&format!("{wrong:?}")), "{wrong}");
        }
        for flag in [DeviceFlag::Cpu, DeviceFlag::Cuda(3), DeviceFlag::Wgpu(0)] {
            assert_eq!(flag.to_string().parse(), Ok(flag));
        }
    }

    #[test]
    fn the_first_device_and_the_others() {
        let (_, others) = start(&[DeviceFlag::Cpu, DeviceFlag::Cpu], 1).unwrap();
        assert_eq!(others.len(), 1);
        assert!(start(&[], 1).is_err());
        // Neither built in nor there: refused by its name, without a panic.
        let error = start(&[DeviceFlag::Cpu, DeviceFlag::Cuda(77)], 1).unwrap_err();
        assert!(error.to_string().contains("cuda:77"), "{error}");
    }
}
