//! What to do where no adapter is found: the one command that installs a driver in software here.

use std::path::Path;

/// Variables that keep the loader, or wgpu, from looking at all that is installed.
const NARROWING: [&str; 3] = ["VK_DRIVER_FILES", "VK_ICD_FILENAMES", "WGPU_BACKEND"];
/// Debian's package lists may be missing, as they are in containers.
const DEBIAN: &str = "apt-get update && SUDO apt-get install -y libvulkan1 mesa-vulkan-drivers";
const FEDORA: &str = "dnf install -y vulkan-loader mesa-vulkan-drivers";
const ARCH: &str = "pacman -S --needed vulkan-icd-loader vulkan-swrast";
const CONDA: &str = "conda install -y -c conda-forge libvulkan-loader mesa-lavapipe";
const GPU_HINT: &str = "where there is a GPU, its own Vulkan driver is what is missing; a container of NVIDIA's needs \
    `--gpus all -e NVIDIA_DRIVER_CAPABILITIES=all`";

/// What this machine says about itself.
struct Machine<'a> {
    /// As in [`std::env::consts::OS`].
    os: &'a str,
    /// The text of `/etc/os-release`.
    os_release: &'a str,
    /// True if this program is part of a conda environment, whose libraries it finds.
    in_conda: bool,
    is_root: bool,
}

/// What is wrong and the command that mends it, in one line; then what else may be the matter.
pub(super) fn message() -> String {
    let os_release =
        ["/etc/os-release", "/usr/lib/os-release"].iter().find_map(|path| std::fs::read_to_string(path).ok());
    let machine = Machine {
        os: std::env::consts::OS,
        os_release: os_release.as_deref().unwrap_or(""),
        in_conda: is_in_conda(),
        is_root: is_root(),
    };
    let narrowing = NARROWING.iter().filter_map(|name| {
        let value = std::env::var_os(name)?;
        Some(format!("\n{name} is set to `{}`: drivers outside of it are not looked for", value.display()))
    });
    advice(&machine) + &narrowing.collect::<String>()
}

fn advice(machine: &Machine) -> String {
    let found_none = "no adapter was found";
    match machine.os {
        "linux" => {
            let mended = match command(machine) {
                Some(command) => format!("`{command}` installs lavapipe, which traces on the processor"),
                None => format!(
                    "install a Vulkan loader and Mesa's lavapipe, which traces on the processor: Debian's packages are \
                     `libvulkan1` and `mesa-vulkan-drivers`; in a conda environment, `{CONDA}`"
                ),
            };
            format!("{found_none}; {mended}\n{GPU_HINT}")
        }
        "macos" => format!(
            "{found_none}; macOS brings Metal, and nothing is to be installed: a virtual machine without a GPU has \
             no adapter, so trace on the Mac itself"
        ),
        "windows" => format!(
            "{found_none}; Windows brings DirectX 12: install the driver of the graphics card, or update it"
        ),
        _ => format!("{found_none}; install a Vulkan loader and a Vulkan driver"),
    }
}

/// Installs lavapipe where the program will find it. `None` on a Linux that is not known here.
fn command(machine: &Machine) -> Option<String> {
    if machine.in_conda {
        return Some(CONDA.into());
    }
    let value = |name| {
        let line =
            machine.os_release.lines().find_map(|line| line.trim().strip_prefix(name)?.strip_prefix('='));
        line.unwrap_or("").trim_matches(['"', '\'']).to_lowercase()
    };
    let names = format!("{} {}", value("ID"), value("ID_LIKE"));
    let command = names.split_whitespace().find_map(|name| match name {
        "debian" | "ubuntu" => Some(DEBIAN),
        "fedora" | "rhel" => Some(FEDORA),
        "arch" => Some(ARCH),
        _ => None,
    })?;
    let sudo = if machine.is_root { "" } else { "sudo " };
    Some(format!("{sudo}{}", command.replace("SUDO ", sudo)))
}

/// A program in the `bin` of a conda environment looks for its libraries in the `lib` beside it.
fn is_in_conda() -> bool {
    let folder = std::env::var_os("CONDA_PREFIX")
        .and_then(|prefix| Path::new(&prefix).join("bin").canonicalize().ok());
    let program = std::env::current_exe().and_then(|program| program.canonicalize());
    folder.is_some_and(|folder| program.is_ok_and(|program| program.starts_with(folder)))
}

#[cfg(target_os = "linux")]
fn is_root() -> bool {
    use std::os::unix::fs::MetadataExt;
    std::fs::metadata("/proc/self").is_ok_and(|process| process.uid() == 0)
}

#[cfg(not(target_os = "linux"))]
fn is_root() -> bool {
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINUX: Machine = Machine { os: "linux", os_release: "", in_conda: false, is_root: false };

    fn first_line(machine: &Machine) -> String {
        advice(machine).lines().next().unwrap().to_string()
    }

    /// Lines out of the files of these distributions.
    #[test]
    fn each_distribution_gets_its_own_command() {
        let debian = "sudo apt-get update && sudo apt-get install -y libvulkan1 mesa-vulkan-drivers";
        let fedora = "sudo dnf install -y vulkan-loader mesa-vulkan-drivers";
        let arch = "sudo pacman -S --needed vulkan-icd-loader vulkan-swrast";
        for (os_release, command) in [
            ("PRETTY_NAME=\"Debian GNU/Linux 12 (bookworm)\"\nVERSION_ID=\"12\"\nID=debian\n", debian),
            ("NAME=\"Ubuntu\"\nVERSION_ID=\"24.04\"\nID=ubuntu\nID_LIKE=debian\n", debian),
            ("NAME=\"Linux Mint\"\nID=linuxmint\nID_LIKE=\"ubuntu debian\"\n", debian),
            ("NAME=\"Fedora Linux\"\nID=fedora\nVERSION_ID=42\n", fedora),
            ("NAME=\"Rocky Linux\"\nID=\"rocky\"\nID_LIKE=\"rhel centos fedora\"\n", fedora),
            ("NAME=\"Arch Linux\"\nID=arch\nBUILD_ID=rolling\n", arch),
            ("NAME=\"Manjaro Linux\"\nID='manjaro'\nID_LIKE=arch\n", arch),
        ] {
            let said = first_line(&Machine { os_release, ..LINUX });
            assert!(
                said.starts_with("no adapter was found; ") && said.contains(&format!("`{command}`")),
                "{said}"
            );
        }
    }

    #[test]
    fn root_needs_no_sudo() {
        let said = first_line(&Machine { os_release: "ID=debian", is_root: true, ..LINUX });
        assert!(said.contains("`apt-get update && apt-get install") && !said.contains("sudo"), "{said}");
    }

    #[test]
    fn a_program_of_a_conda_environment_is_helped_by_conda() {
        let said = first_line(&Machine { os_release: "ID=debian", in_conda: true, ..LINUX });
        assert!(said.contains(CONDA) && !said.contains("apt-get"), "{said}");
    }

    #[test]
    fn an_unknown_linux_gets_names_of_packages_and_no_wrong_command() {
        for os_release in ["", "ID=", "garbage", "ID=nixos\n", "NAME=debian\nVARIANT_ID=debian\n"] {
            let said = first_line(&Machine { os_release, ..LINUX });
            assert!(said.contains("lavapipe") && said.contains(CONDA) && !said.contains("apt-get"), "{said}");
        }
    }

    #[test]
    fn macs_are_sent_to_no_driver() {
        let said = advice(&Machine { os: "macos", ..LINUX });
        assert!(said.contains("Metal") && !said.contains("install -y"), "{said}");
    }
}
