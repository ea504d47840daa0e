"""The sentences of `sentences.english` in Simplified Chinese: the same keys, the same placeholders, the same contents.

Its terms are those of the Chinese pages about faults (docs/faults/*.zh.md). Commands, keys of the arm file and names
that people find in logs and menus stay as they are.
"""

from sentences.meaning import Meaning, Silence
from sentences.meaning import Phrases as _Phrases
from shm.words import Answer, BusState, Fault, GripTrouble, Mode, Outcome, Request, Unreferenced

OUTCOMES: dict[Outcome, Meaning] = {
    Outcome.NONE: Meaning(
        "目标还没有定论。",
        "目标从宣布起，到控制进程结束它为止，都没有定论。",
        "等待结果，或者取消它。",
    ),
    Outcome.SUCCEEDED: Meaning(
        "目标已到达：最大误差是 {joint} 的 {value:.4f} rad，允许 {limit:.4f} rad。",
        "成功的意思是每个实测关节都在目标容差之内，而不是时间到了。",
        "不需要做什么。",
    ),
    Outcome.CANCELED: Meaning(
        "已取消：机械臂静止，没有离开路径。",
        "取消是让轨迹时钟减慢到停，所以机械臂绝不离开规划的路径。",
        "从机械臂所在处重新规划。",
    ),
    Outcome.REPLACED: Meaning(
        "目标被更新的目标取代，或者被 ~/joint_trajectory 上的轨迹取代。",
        "同一时间只有一个目标带动机械臂，最新的才是使用者想要的。",
        "如果每个目标都要完成，请一个接一个地发送。",
    ),
    Outcome.STOPPED: Meaning(
        "有人停下了机械臂：它已在路径上静止，`rtarm resume`（或 ~/resume）之前不接受目标。",
        "ROS 一侧失灵时停止也必须有效；客户端重发目标时也必须保持停止。",
        "弄清原因，恢复，然后从机械臂所在处重新规划。",
    ),
    Outcome.PATH_TOLERANCE: Meaning(
        "{joint} 离设定点 {value:.4f} rad，允许 {limit:.4f} rad：看是什么阻碍它，动得慢一些，或者放宽 path_tolerance。",
        "落后于设定点的关节，会使机械臂离开规划好的无碰撞路径。",
        "查找障碍物、负载或过低的电流限值；放慢运动；之后如果误差可以接受，再放宽目标的 path_tolerance 或 trajectory.path_tolerance_rad。",
    ),
    Outcome.GOAL_TOLERANCE: Meaning(
        "到达时间用完时，{joint} 离目标位置 {value:.4f} rad，允许 {limit:.4f} rad：看是什么阻碍它，或者放宽 goal_tolerance 或 goal_time_tolerance。",
        "永远到不了的目标必须结束，否则客户端会一直等下去。",
        "查找障碍物或负载；用 goal_time_tolerance 或 trajectory.goal_time_s 给更多时间，或者用 goal_tolerance 或 trajectory.goal_tolerance_rad 允许更大的误差。",
    ),
    Outcome.FAULT: Meaning(
        "控制进程锁存了故障，停下了机械臂：看 `rtarm status`，消除原因，然后 `rtarm clear-fault`。",
        "锁存的故障结束所有目标；在有人清除它之前什么都不动。",
        "读故障的句子，消除原因，清除它。",
    ),
    Outcome.STARVED: Meaning(
        "轨迹不再从 ROS 进程到来，机械臂在已有的那一段上制动：看那个进程的日志和机器的负载，再发一次目标。",
        "趁还有路径可以制动时就开始制动。",
        "查找卡住或过载的 ROS 进程，然后再发一次目标。",
    ),
    Outcome.FRONT_LOST: Meaning(
        "ROS 进程已有 {value:.3f} s 没有动静，允许 {limit:.3f} s，机械臂已沿路径停下：重启那个进程，或者减轻机器的负载。",
        "ROS 进程不在了，就没有人能取消它的运动。",
        "`rtarm up` 会自动重启这个进程；看它的日志和机器的负载。",
    ),
    Outcome.SHUTDOWN: Meaning(
        "控制进程正在结束，机械臂已在路径上静止：要继续请重新启动它。",
        "正常结束时，先让机械臂停下，再关闭其他一切。",
        "用 `rtarm up` 重新启动，然后从机械臂所在处重新规划。",
    ),
    Outcome.REFUSED_MODE: Meaning(
        "控制进程现在的状态是“{value:mode}”，不接受目标；只有“保持”和“执行中”时接受：等待，驱动器松开了就使能，或者看 `rtarm status`。",
        "只有确知驱动器会跟随时，才开始执行目标。",
        "等启动结束，清除故障，或者使能驱动器。",
    ),
    Outcome.REFUSED_OUTDATED: Meaning(
        "它到来之后，机械臂被停下、暂停、松开、回零或出了故障，所以它不会开始：看机械臂停在哪里，再重新发送。",
        "发送者不知道这件事，而它会让一台没有人预料会动的机械臂动起来。",
        "从机械臂现在所在处重新规划，再发送。",
    ),
    Outcome.REFUSED_HELD: Meaning(
        "有人停下或暂停了机械臂，所以这不会开始：先用 `rtarm resume`（或 ~/resume）让它继续，再重新发送。",
        "停下机械臂的人是有意的，而数据流和重发目标的客户端都不知道这一点。",
        "先问是谁、为什么停下的；然后用 `rtarm resume`、服务 ~/resume，或者页面上的“继续”。",
    ),
    Outcome.REFUSED_STREAM: Meaning(
        "所有驱动器沉默了片刻，机械臂已经自己重新保持，数据流要等人：看机械臂停在哪里，然后 `rtarm resume`（或 ~/resume）。",
        "数据流在运动中被打断，发送它的一方可能不知道机械臂现在在哪里。",
        "确认没有东西挡着机械臂；然后用 `rtarm resume`、服务 ~/resume，或者页面上的“继续”。",
    ),
    Outcome.REFUSED_UNREFERENCED: Meaning(
        "{joint} 未建立参考点，角度未知，所以不接受目标：原因和该怎么办看 `rtarm status`。",
        "要运动到某个角度，必须知道现在的角度。",
        "按照 `rtarm status` 对这个关节所说的去做。",
    ),
    Outcome.REFUSED_START: Meaning(
        "在进入轨迹的地方，{joint} 离指令位置 {value:.4f} rad，允许 {limit:.4f} rad：从当前状态规划，或者让第一个点的 time_from_start 大于 0。",
        "从别处开始就会是突跳。",
        "从当前状态规划。",
    ),
    Outcome.REFUSED_LIMITS: Meaning(
        "从机械臂当前的运动出发，没有办法在遵守每个关节限值的同时转到这条轨迹上：从静止开始，或者给轨迹更多时间。",
        "新轨迹从指令的位置、速度和加速度开始，没有突跳。",
        "等机械臂静止，或者发送一条开头更平缓的轨迹。",
    ),
    Outcome.REFUSED_CORRUPT: Meaning(
        "控制进程拒绝了一个轨迹点（{joint}，数值 {value:g}，限值 {limit:g}），尽管 ROS 进程检查过它：两者必须出自同一份安装和同一个机械臂文件；请报告。",
        "控制进程不相信从共享内存里读到的任何内容。",
        "用同一份安装重启两个进程；如果再次发生，请连同目标一起报告。",
    ),
    Outcome.RAN_DRY: Meaning(
        "机械臂还在运动时，流的下一个点没有及时到来，所以它越过最后一点沿直线停下：请更早发送各点，并以静止的点结束流。",
        "发送者接下来想做什么无从得知；直着走停下最不出人意料。",
        "如果是有意结束，不需要做什么；否则查找是什么拖延了发送者。",
    ),
    Outcome.PATH_VELOCITY: Meaning(
        "{joint} 的速度与设定点相差 {value:.4f} rad/s，允许 {limit:.4f} rad/s：看是什么阻碍它，动得慢一些，或者放宽 path_tolerance。",
        "目标要求在途中监视它的速度。",
        "查找障碍物或负载；放慢运动；然后放宽目标的 path_tolerance。",
    ),
    Outcome.PATH_ACCELERATION: Meaning(
        "{joint} 平滑后的加速度与设定点相差 {value:.3f} rad/s²，允许 {limit:.3f} rad/s²：看是什么阻碍它，动得慢一些，或者放宽 path_tolerance。",
        "目标要求在途中监视它的加速度。",
        "查找障碍物或负载；放慢运动；然后放宽目标的 path_tolerance。",
    ),
    Outcome.GOAL_VELOCITY: Meaning(
        "到达时间用完时，{joint} 仍以 {value:.4f} rad/s 运动，允许 {limit:.4f} rad/s：看是什么带动它，或者放宽 goal_tolerance 或 goal_time_tolerance。",
        "机械臂停在那里才算到达目标，经过那里不算。",
        "查找振荡或负载；给更多时间，或者在 goal_tolerance 或 trajectory.stopped_velocity_rad_s 里允许更大的速度。",
    ),
    Outcome.GOAL_ACCELERATION: Meaning(
        "到达时间用完时，{joint} 平滑后的加速度与设定点相差 {value:.3f} rad/s²，允许 {limit:.3f} rad/s²：看是什么带动它，或者放宽 goal_tolerance。",
        "目标要求在结束时监视它的加速度。",
        "查找振荡；给更多时间，或者放宽 goal_tolerance。",
    ),
    Outcome.CLOCK_GAP: Meaning(
        "控制周期中断了 {value:.3f} s，驱动器只预先行进 {limit:.3f} s，所以已自行停下：查找是什么让机器挂起或过载。",
        "这样的中断之后，驱动器停在没有人规划过的位置，轨迹不可以继续。",
        "找出是什么让机器挂起或过载；从机械臂所在处重新规划。",
    ),
}

FAULTS: dict[Fault, Meaning] = {
    Fault.NONE: Meaning("没有故障。", "", ""),
    Fault.NOT_FINITE: Meaning(
        "{joint} 的设定点是 {value:g}，它不是一个数，所以没有发送：连同目标一起报告，然后 `rtarm clear-fault`。",
        "最后一道防线：这样的设定点只可能出自程序缺陷。",
        "清除故障；连同目标和日志一起报告。",
    ),
    Fault.POSITION_LIMIT: Meaning(
        "{joint} 的设定点通往 {value:.4f} rad，越过限位 {limit:.4f} rad，所以没有发送：检查轨迹和机械臂文件里的限位，然后 `rtarm clear-fault`。",
        "目标检查之后的最后一道防线：超出关节限位的设定点从不发送，会让关节来不及在限位之前停下的设定点也从不发送。",
        "检查轨迹和机械臂文件里的限位；清除故障。",
    ),
    Fault.VELOCITY_LIMIT: Meaning(
        "{joint} 的设定点速度是 {value:.4f} rad/s，允许 {limit:.4f} rad/s，所以没有发送：给轨迹更多时间，然后 `rtarm clear-fault`。",
        "目标检查之后的最后一道防线。",
        "给轨迹更多时间；清除故障。",
    ),
    Fault.ACCELERATION_LIMIT: Meaning(
        "{joint} 的设定点加速度是 {value:.3f} rad/s²，允许 {limit:.3f} rad/s²，所以没有发送：把轨迹变平滑，然后 `rtarm clear-fault`。",
        "目标检查之后的最后一道防线。",
        "给轨迹更多时间，或者把它变平滑；清除故障。",
    ),
    Fault.FOLLOWING_ERROR: Meaning(
        "{joint} 离指令位置 {value:.4f} rad，允许 {limit:.4f} rad：查找障碍物、负载或无力的驱动器，然后 `rtarm clear-fault`。",
        "不跟随的关节是被挡住了、过载了，或者没有动力。",
        "让机械臂脱离阻碍，检查驱动器的电流限值和供电，清除故障。",
    ),
    Fault.STALE_READING: Meaning(
        "{joint} 已有 {value:.3f} s 没有给出可信的应答，允许 {limit:.3f} s：检查驱动器的供电、插头和电缆，然后 `rtarm clear-fault`。",
        "没有读数，就没有人知道关节在哪里。",
        "检查驱动器的供电、插头和电缆；清除故障。驱动器不能证明自己一直有电时，关节与读数相符就用 `rtarm reference`，不相符就回零。",
    ),
    Fault.DRIVE_FAULT: Meaning(
        "{joint} 的驱动器报告了它自身的故障（{value:drive}）：消除原因，然后 `rtarm clear-fault`。",
        "有错误或者没有使能的驱动器不会跟随设定点，也可能什么都保持不住。",
        "看它所指的那一项，看驱动器的显示屏或厂家工具：让关节脱离阻碍，让驱动器冷却，检查它的供电、编码器和电缆；清除故障。",
    ),
    Fault.REFERENCE_LOST: Meaning(
        "{joint} 失去了参考点，角度未知，不会带动它：原因和该怎么办看 `rtarm status`。",
        "掉电或突变之后，驱动器的计数不再对应某个角度。",
        "按照 `rtarm status` 对这个关节所说的去做；只用 `rtarm clear-fault` 绝不能让它重新建立参考点。",
    ),
    Fault.COMMAND_RING: Meaning(
        "命令内存里的内容不可能是对的（数值 {value:g}，限值 {limit:g}），任何内容都没有采用：重启 ROS 进程，然后 `rtarm clear-fault`。",
        "控制进程不相信它读到的任何内容：损坏的环形缓冲区绝不能带动机械臂。",
        "用同一份安装重启 ROS 进程；清除故障。",
    ),
    Fault.WIRE: Meaning(
        "CAN 适配器不在，或者拒绝工作：检查它的电缆，确认没有别的程序打开它，等到说明它已回来的事件，然后 `rtarm clear-fault`。",
        "没有适配器，就无法告诉任何驱动器任何事。",
        "把它插回去；它回来时控制进程会说明；清除故障。驱动器沉默太久的关节已经失去参考点：与读数相符的用 `rtarm reference`，其余的回零。",
    ),
    Fault.LINK_DOWN: Meaning(
        "CAN 接口被关闭：重新设置它（`sudo ip link set can0 up type can bitrate 500000`），等到说明它已回来的事件，然后 `rtarm clear-fault`。",
        "关闭的接口什么都发不出去，它积压的内容也丢失了。",
        "弄清是谁关闭了它；重新设置；它回来时控制进程会说明；清除故障。驱动器沉默太久的关节已经失去参考点：与读数相符的用 `rtarm reference`，其余的回零。",
    ),
    Fault.HOMING: Meaning(
        "{joint} 没有回零成功，静止之前请远离：原因看控制进程的消息，排除之后 `rtarm clear-fault`，再 `rtarm home` 一次。",
        "没有找到机械限位的关节，不知道自己从哪里开始计数。",
        "按照控制进程的消息去做；清除故障；让这个关节再回零一次。",
    ),
    Fault.BUS_OFF: Meaning(
        "错误太多，CAN 控制器已离开总线（bus-off）：检查接线、终端电阻和比特率，如果没有设 restart-ms 就重启它（`sudo ip link set can0 type can restart`），然后 `rtarm clear-fault`。",
        "离开总线的控制器在重启之前什么都不发送。",
        "查找短路、缺少的 120 Ω，或者比特率不同的节点；重启控制器；清除故障。",
    ),
    Fault.BRING_UP: Meaning(
        "启动驱动器失败：是哪个驱动器、为什么，看控制进程的消息，排除之后 `rtarm clear-fault`。",
        "启动时应答不对的驱动器不会被带动。",
        "按照控制进程的消息去做；清除故障。",
    ),
    Fault.RELEASE: Meaning(
        "机械臂本应松开，但 {joint} 的驱动器仍然使能：请远离，看驱动器的显示屏，然后 `rtarm clear-fault`。",
        "一台有的关节松开、有的关节保持的机械臂，不能被当成可以用手拖动的机械臂。",
        "看驱动器的显示屏；清除故障，这会重新启动所有驱动器。",
    ),
}

_NO_DRIVE = "没有一个驱动器给出可信的应答已有 {value:.3f} s，允许 {limit:.3f} s"
_THEN = "，然后 `rtarm clear-fault`。"

SILENCES: dict[Silence, Meaning] = {
    Silence.SEVERAL_DRIVES: Meaning(
        "{joint} 已有 {value:.3f} s 没有给出可信的应答，允许 {limit:.3f} s，而其他驱动器在应答：检查它们共用的电源和电缆"
        + _THEN,
        "一起沉默的驱动器，失去的是它们共用的东西。",
        "检查它们共用的电源，以及到其中第一个驱动器的 CAN 电缆；清除故障。",
    ),
    Silence.NOT_BELIEVED: Meaning(
        _NO_DRIVE
        + "，尽管驱动器的帧仍然到来：检查驱动器菜单里的 Checksum（0x6B）、串口上的乱码，以及驱动器是否听到所发的内容"
        + _THEN,
        "不可能正确的应答不说明任何位置。",
        "看 `rtarm status` 里的线路错误、驱动器的菜单和适配器；清除故障。",
    ),
    Silence.NOT_ACKNOWLEDGED: Meaning(
        _NO_DRIVE + "，也没有一个确认所发的内容：先看驱动器的电源和开关，再看通往它们的 CAN 电缆" + _THEN,
        "有电并且听到帧的驱动器都会确认它，不论怎么看待它。",
        "给驱动器通电；检查 CAN 电缆和比特率；清除故障。",
    ),
    Silence.BABBLE: Meaning(
        _NO_DRIVE + "，而不属于任何驱动器的帧占满了总线：找出不停发送的节点（逐个拔下来）" + _THEN,
        "优先级更高又从不停顿的节点，不让任何驱动器应答。",
        "找出那个节点；清除故障。",
    ),
    Silence.BUS: Meaning(
        _NO_DRIVE + "，而且 CAN 控制器报告了错误：检查接线、插头和两端的 120 Ω，并确认驱动器有电" + _THEN,
        "受干扰的总线上没有一个帧能完整到达。",
        "检查接线、插头和终端电阻，以及驱动器的供电；清除故障。",
    ),
    Silence.MACHINE: Meaning(
        _NO_DRIVE
        + "，而且这台机器没有及时运行控制进程：找出是什么使它过载或挂起（`rtarm doctor`），并确认驱动器有电"
        + _THEN,
        "这期间到来的内容可能没有被及时读取。",
        "减轻机器的负载，为它做实时设置（`rtarm doctor --fix`）；清除故障。",
    ),
    Silence.SIMULATED_ARM: Meaning(
        "仿真机械臂没有一个驱动器应答已有 {value:.3f} s，允许 {limit:.3f} s：这台机器太忙，没能及时运行它（它自己的那一行会说明），或者沉默是有意安排的；减轻机器的负载"
        + _THEN,
        "仿真机械臂是一个程序，别的程序可能耽误它。",
        "查找是什么使机器忙碌（`rtarm doctor`）；清除故障。",
    ),
    Silence.NOT_TAKEN: Meaning(
        _NO_DRIVE
        + "，而且适配器没有全部接收所写的内容：看适配器、它的 USB 电缆和集线器，再看驱动器的电源和开关"
        + _THEN,
        "适配器没有接收的内容，永远到不了驱动器。",
        "把适配器插到另一个端口，不用集线器；确认驱动器有电；清除故障。",
    ),
    Silence.ADAPTER: Meaning(
        _NO_DRIVE
        + "，适配器也同时沉默了：看适配器、它的 USB 电缆和集线器，看这台机器是否太忙、没有传递它的字节（`rtarm doctor`），并确认驱动器有电"
        + _THEN,
        "对每个帧都应答的适配器沉默了，说明它或者通往它的路停住了。",
        "把适配器插到另一个端口，不用集线器；减轻机器的负载；清除故障。",
    ),
    Silence.SUPPLY_OR_CABLE: Meaning(
        _NO_DRIVE + "，而适配器一直在应答：先看驱动器的电源和开关，再看适配器与驱动器之间的 CAN 电缆" + _THEN,
        "驱动器共用电源，所以一起沉默多半是因为没有电。",
        "给驱动器通电；检查 CAN 电缆和插头；清除故障。",
    ),
    Silence.SUPPLY: Meaning(
        _NO_DRIVE + "：先看驱动器的电源和开关，再看 CAN 电缆、适配器和它的 USB 电缆" + _THEN,
        "驱动器共用电源，所以一起沉默多半是因为没有电。",
        "给驱动器通电；检查 CAN 电缆、适配器和它的 USB 电缆；清除故障。",
    ),
}

BUS_STATES: dict[BusState, Meaning] = {
    BusState.ACTIVE: Meaning("总线正常。", "", ""),
    BusState.WARNING: Meaning(
        "CAN 控制器数到了许多错误：检查接线、插头和终端电阻。",
        "到 96 个错误时控制器发出警告；正常的帧使计数再降下来。",
        "检查接线、插头和两端的 120 Ω。",
    ),
    BusState.PASSIVE: Meaning(
        "CAN 控制器处于被动错误状态（error-passive），机械臂的帧可能丢失：确认驱动器有电、比特率都相同、总线两端有 120 Ω。",
        "到 128 个错误时控制器不再报告错误；没有人确认的总线会立刻到这一步。",
        "给驱动器通电；比较比特率；检查接线和终端电阻。",
    ),
    BusState.BUS_OFF: Meaning(
        "CAN 控制器已离开总线：排除总线的问题，重启控制器（`sudo ip link set can0 type can restart`），然后 `rtarm clear-fault`。",
        "到 256 个错误时控制器不再参与。",
        "排除总线的问题，重启控制器，清除故障。",
    ),
}

UNREFERENCED: dict[Unreferenced, Meaning] = {
    Unreferenced.REFERENCED: Meaning("{joint} 已建立参考点。", "", ""),
    Unreferenced.NOT_BROUGHT_UP: Meaning(
        "{joint} 还没有启动，因此角度未知：等启动结束。",
        "只有启动过程才能得知驱动器的计数是什么意思。",
        "等待，或者看启动为什么不结束。",
    ),
    Unreferenced.POWER_LOST: Meaning(
        "{joint} 的驱动器可能断过电，因此角度未知：用 `rtarm home` 回零，或者用 `rtarm reference` 说明它的位置。",
        "驱动器从上电时所在的位置开始计数；标记还在，就证明它没有断过电。",
        "让关节回零；或者看清它，说明角度（`rtarm reference JOINT=DEGREES`）。",
    ),
    Unreferenced.POSITION_JUMP: Meaning(
        "{joint} 的实测位置发生突变，因此角度未知：检查驱动器，然后用 `rtarm home` 回零，或者用 `rtarm reference` 说明它的位置。",
        "没有哪个关节一个周期里能走那么远；一定是计数的含义变了。",
        "检查编码器和供电；让关节回零，或者看清它、说明它的位置。",
    ),
    Unreferenced.SILENT: Meaning(
        "{joint} 的驱动器沉默太久，因此角度未知：如果 `rtarm clear-fault` 没有恢复它，看关节是否在 `rtarm status` 所说的位置，是就用 `rtarm reference` 确认，否则回零。",
        "断了联系的驱动器，这期间可能断过电、被移动过。",
        "看看关节；与读数相符就用 `rtarm reference`，不相符就回零。",
    ),
    Unreferenced.TARGET_FAR: Meaning(
        "{joint} 的驱动器离它自己的目标位置很远，因此采用哪一个都会让它动，或者不符合事实：让关节脱离阻碍，在 `rtarm status` 所说的位置就用 `rtarm reference` 确认，否则回零。",
        "目标与位置不一致，说明关节被外力挡在目标之外，或者计数错了。",
        "让关节脱离阻碍；与读数相符就用 `rtarm reference`，不相符就回零。",
    ),
    Unreferenced.NOT_HOMED: Meaning(
        "{joint} 的计数失去意义之后还没有回过零，因此角度未知：用 `rtarm home` 回零，或者用 `rtarm reference` 说明它的位置。",
        "回零会改变驱动器计数的含义，而改变的时刻别人无从得知。",
        "回零；或者看清关节，说明它的角度（`rtarm reference JOINT=DEGREES`）。",
    ),
    Unreferenced.MOVED: Meaning(
        "{joint} 不在 rtarm 结束时的位置，因此要么有人用手动过它，要么驱动器丢了计数：看它是否在 `rtarm status` 所说的位置，是就用 `rtarm reference` 确认，否则回零。",
        "旧固件不会说明自己断过电，而这期间没有人监视。",
        "看清关节；与读数相符就用 `rtarm reference`，不相符就回零。",
    ),
    Unreferenced.INCREMENTAL: Meaning(
        "{joint} 的驱动器不知道上电时在什么位置，因此角度未知：用 `rtarm reference` 说明它的位置，驱动器能回零的话也可以回零。",
        "增量编码器知道自己转了多少，不知道自己在哪里；绝对编码器也只在自己的量程之内知道。",
        "看清关节，说明它的角度（`rtarm reference JOINT=DEGREES`），或者 `rtarm home`。",
    ),
    Unreferenced.OUTSIDE_LIMITS: Meaning(
        "{joint} 在限位之外，因此计数或零点一定有错：用 `rtarm home` 回零，或者用 `rtarm reference` 说明它的位置；如果再次出现，检查机械臂文件里的 zero_deg、direction 和限位（rtarm 启动时读取）。",
        "机械臂文件说关节绝不会在那里，它就不可能在那里。",
        "让关节回零，或者说明它的角度（`rtarm reference JOINT=DEGREES`）；检查机械臂文件里的 zero_deg、direction 和限位，然后重新启动 rtarm。",
    ),
}

ANSWERS: dict[Answer, Meaning] = {
    Answer.NONE: Meaning("请求还没有得到回答。", "", ""),
    Answer.DONE: Meaning("完成。", "", ""),
    Answer.REFUSED_MODE: Meaning(
        "控制进程在现在的状态下做不到：看 `rtarm status`。",
        "哪些状态变化是允许的，由一个表说明。",
        "等到可以这样做的状态。",
    ),
    Answer.REFUSED_NO_GOAL: Meaning(
        "没有这样的目标在执行，所以不需要做什么。",
        "关于某个目标的请求，可能在目标结束之后才到。",
        "不需要做什么。",
    ),
    Answer.REFUSED_VALUE: Meaning(
        "这个值不允许：速度比例在 0 和 1 之间，关节在限位之内，断过电或没有回零到底的驱动器不知道从哪里开始计数。",
        "控制进程不相信不可能的值。",
        "速度比例用 0 到 1，角度在关节的限位之内，关节是这台机械臂有的。",
    ),
    Answer.REFUSED_MOVING: Meaning(
        "机械臂在运动，或者还没有停稳：等它静止再来一次。",
        "正在使机械臂制动的过程不会被打断，运动中的机械臂也不会被松开。",
        "等什么都不动了再来一次。",
    ),
    Answer.REFUSED_WIRE: Meaning(
        "CAN 适配器不在，所以无法启动驱动器：插上它或者设置好接口，等到说明它已回来的事件，再来一次。",
        "清除故障要与每个驱动器对话。",
        "等控制进程说明适配器已回来。",
    ),
    Answer.REFUSED_OUTDATED: Meaning(
        "提出请求之后，机械臂被停下、暂停、松开、回零或出了故障，所以它不会开始：再来一次。",
        "提出请求的人不知道这件事，而它会让一台没有人预料会动的机械臂动起来。",
        "看机械臂停在哪里，再来一次。",
    ),
    Answer.REFUSED_HELD: Meaning(
        "有人停下或暂停了机械臂，所以带动它的任何事都不会开始：先 `rtarm resume`（或 ~/resume）。",
        "由人停下的，只有人能让它再动起来。",
        "先问是谁、为什么停下的，然后恢复。",
    ),
    Answer.REFUSED_UNKNOWN: Meaning(
        "控制进程不认识这个请求：用同一份安装启动两个进程。",
        "不认识的请求会被拒绝，绝不猜测。",
        "用同一份安装重启两个进程。",
    ),
}

GRIP_TROUBLES: dict[GripTrouble, Meaning] = {
    GripTrouble.NONE: Meaning("夹爪正常。", "", ""),
    GripTrouble.SILENT: Meaning(
        "夹爪的驱动器（地址 {value:.0f}）没有应答：检查它的供电、菜单里的地址和比特率，以及 CAN 接线。",
        "没有消息的东西可能在任何位置。",
        "检查供电、地址、比特率和接线；它一应答就会重新接上。",
    ),
    GripTrouble.FIRMWARE: Meaning(
        "夹爪驱动器的固件（版本 {value:.0f}）的设置在这里是未知的，所以不带动它：使用 Emm_V5 固件 1.0.0 到 2.9.9 的驱动器。",
        "别的固件会把同一条命令当成另一个角度。",
        "把驱动器换成 Emm 固件，或者换一个驱动器。",
    ),
    GripTrouble.MICROSTEPS: Meaning(
        "夹爪的驱动器设为 {value:.0f} 细分，而机械臂文件写的不同，角度会差这个倍数：改其中一个。",
        "命令数的是细分步。",
        "修改 gripper.servo.microsteps，或者驱动器的菜单。",
    ),
    GripTrouble.CHECKSUM: Meaning(
        "夹爪的驱动器使用校验方式 {value:.0f}，而这里只用 0（固定的 6B）：把它菜单里的 Checksum 设为 0x6B。",
        "其他校验方式的说明互相矛盾。",
        "把驱动器菜单里的 Checksum 设为 0x6B。",
    ),
    GripTrouble.PROTECTED: Meaning(
        "夹爪的驱动器触发了保护，什么都没有夹住：移开挡住它的东西；下一条命令会清除保护。",
        "顶着东西推得太久的驱动器会自己松开。",
        "让手指脱离阻碍，让驱动器冷却，发送下一条命令。",
    ),
    GripTrouble.DISABLED: Meaning(
        "夹爪的驱动器没有使能，什么都没有夹住：下一条命令会使能它；如果不能，看它菜单里的 En 设置。",
        "有人松开了它：在它的菜单里，或者通过 En 输入。",
        "发送下一条命令；看驱动器的 En 设置。",
    ),
    GripTrouble.POWER_LOST: Meaning(
        "夹爪的驱动器断过电，它的计数不是角度，所以不带动它：清空手指之间，然后调用它的控制器的 home 服务。",
        "驱动器从上电时所在的位置开始计数。",
        "清空手指之间，让它回零。",
    ),
    GripTrouble.REFUSED: Meaning(
        "夹爪的驱动器不接受去 {value:.3f} rad 的命令：看它的显示屏有没有故障。",
        "丢失的命令会重复好几次。",
        "看驱动器的显示屏，检查接线，再发一次命令。",
    ),
    GripTrouble.NOT_HOMED: Meaning(
        "夹爪的驱动器没有找到机械限位（计数 {value:.0f}）：确认它能到达那里，菜单里的方向、速度和碰撞电流合适，再回零一次。",
        "没有机械限位，就没有人知道它的计数是什么意思。",
        "检查驱动器菜单里的回零参数；再回零一次。",
    ),
    GripTrouble.OUTSIDE: Meaning(
        "夹爪的读数是 {value:.3f} rad，远在行程之外，所以不带动它：让它回零，或者改正 gripper.servo 的 zero_deg、direction 或 ratio。",
        "从那里发出的命令可能使它多转好几圈。",
        "让它回零；把 gripper.servo 与机械结构对照。",
    ),
    GripTrouble.CURRENT: Meaning(
        "夹爪的驱动器不接受 {value:.0f} mA 的电流限值，所以没有带动它：在它的菜单里设置，并去掉 gripper.servo.nm_per_ampere。",
        "写明力的命令不可以推得更重。",
        "发送不带力的命令，或者去掉 nm_per_ampere。",
    ),
}

PHRASES = _Phrases(
    modes={
        Mode.OFFLINE: "离线",
        Mode.BRINGING_UP: "正在启动",
        Mode.HOLDING: "保持",
        Mode.EXECUTING: "执行中",
        Mode.STOPPING: "正在停止",
        Mode.FAULT: "故障",
        Mode.DISABLED: "已失能",
        Mode.REFERENCING: "正在回零",
        Mode.FREE: "自由拖动",
    },
    unknown_mode="未知状态 {mode}",
    unknown_status="未知状态字 {status}",
    unknown="未知的编号 {number}（{kind}）：用同一份安装启动所有进程。",
    no_joint="（没有关节）",
    between="、",
    before_last="、",
    each_of="{joints}",
    so="，因此",
    healed="所有驱动器沉默了片刻；每个都没有断过电，也停在允许的位置，所以机械臂自己重新保持，接受下一个目标。数据流要等 `rtarm resume`。",
    wire_is_back="适配器已回来：`rtarm clear-fault` 会重新启动驱动器。",
    of_bus="总线 {bus}：{sentence}",
    asked={Request.STOP: "停止", Request.HOLD: "暂停", Request.RESUME: "继续"},
    asked_by="进程 {process:.0f} 请求{what}。",
    speed_asked="请求速度比例 {scale:.0%}。",
    unknown_command="未知的命令 {kind}",
)
