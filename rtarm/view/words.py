"""Every word that stands on the page alone, in English and in Simplified Chinese.

Sentences about faults, goals and requests come from `sentences.told`; what other tools say too comes from where they
say it (`rtarm.console.language`).
"""

from __future__ import annotations

from dataclasses import dataclass

from sentences.meaning import Language


@dataclass(frozen=True)
class Words:
    """The page in one language; braces stand for figures and names."""

    language: Language
    title: str
    waiting: str
    fit: str
    unfit: str
    held: str
    held_tag: str
    goal: str
    no_goal: str
    goal_of: str
    goal_endless: str
    last_result: str
    no_geometry: str
    hold: str
    hold_hint: str
    resume: str
    resume_hint: str
    stop: str
    stop_hint: str
    clear_fault: str
    clear_fault_hint: str
    enable: str
    enable_hint: str
    enable_question: str
    enable_warning: str
    enable_yes: str
    reference: str
    reference_hint: str
    reference_question: str
    stands_at: str
    reference_yes: str
    no: str
    speed: str
    speed_hint: str
    joints: str
    joint: str
    measured: str
    commanded: str
    error: str
    near_lower: str
    near_upper: str
    beyond: str
    gripper: str
    move: str
    move_help: str
    go: str
    go_nowhere: str
    go_hint: str
    back: str
    back_hint: str
    goal_runs: str
    under_way: str
    broken: str
    on_the_way: str
    no_answer: str
    no_result: str
    already: str
    plots: str
    which_joint: str
    all_joints: str
    position_plot: str
    error_plot: str
    lateness_plot: str
    seconds: str
    late: str
    events: str
    nothing_yet: str
    machine: str
    cycles: str
    cycles_told: str
    overruns: str
    overruns_told: str
    lateness: str
    cycle_time: str
    percentiles: str
    bus: str
    bus_told: str
    buses: str
    no_bus: str
    bus_trouble: str
    ros: str
    ros_none: str
    ros_told: str
    control: str
    control_told: str
    recording: str


ENGLISH = Words(
    language="en",
    title="rtarm: {arm}",
    waiting="waiting",
    fit="ready to move",
    unfit="not fit to move",
    held="held",
    held_tag="waits for Resume",
    goal="Goal: {stands}, speed {scale:.0%}",
    no_goal="none",
    goal_of="{id} {phase}, {clock:.1f} of {duration:.1f} s",
    goal_endless="{id} {phase}, {clock:.1f} s",
    last_result="Last goal ({id}): {sentence}",
    no_geometry="The arm file has no section kinematics, so there is no picture of the arm; everything else works.",
    hold="Hold",
    hold_hint="Stops the arm on its path; its goal waits, and none begins before Resume. No emergency stop: that is "
    "the switch in the power line.",
    resume="Resume",
    resume_hint="A held goal goes on: the arm moves. An arm that was held or stopped takes goals again.",
    stop="Stop and end the goal",
    stop_hint="Stops the arm on its path and ends the goal; it takes none before Resume, whoever sends it. "
    "No emergency stop: that is the switch in the power line.",
    clear_fault="Clear fault",
    clear_fault_hint="Once its cause is removed: brings the drives up again; the arm then holds where it stands.",
    enable="Enable drives …",
    enable_hint="Asks once more, then the drives take hold of the limp arm where it stands.",
    enable_question="Enable the drives of {arm}?",
    enable_warning="The drives take hold of the arm where it stands. Keep hands and things out of its way.",
    enable_yes="Enable the drives",
    reference="Confirm where the joints stand …",
    reference_hint="Joints without a reference: shows where each would stand, and asks. Nothing moves.",
    reference_question="Look at {arm}, twice: do its joints stand there? Every goal will believe it.",
    stands_at="angle °",
    reference_yes="They stand there",
    no="Leave it as it is",
    speed="Speed %",
    speed_hint="Slows down every goal, of whomever, on its path; 0 stands still.",
    joints="Joints",
    joint="joint",
    measured="measured °",
    commanded="commanded °",
    error="error °",
    near_lower="{joint} is {distance:.1f}° from its lower limit ({limit:g}°)",
    near_upper="{joint} is {distance:.1f}° from its upper limit ({limit:g}°)",
    beyond="{joint} is {distance:.1f}° beyond its limit ({limit:g}°)",
    gripper="gripper: {does}",
    move="Move",
    move_help="Move the sliders: the green arm shows where they would take it. Nothing moves before you press Go. "
    "Nothing checks for collisions on this way: look at the arm.",
    go="Go there: the arm moves for {duration:.1f} s",
    go_nowhere="Go there",
    go_hint="Sends one goal to the arm's ordinary action, which checks it. A goal that runs is never replaced.",
    back="Sliders back to the arm",
    back_hint="Forgets the wish; nothing moves.",
    goal_runs="Goal {id} is running, and a goal that runs is never replaced from here: wait until it has ended, or "
    "stop it first.",
    under_way="{what}: under way …",
    broken="{what}: a bug of the page ended it, which is told where the page was started. Look at the arm, and use "
    "`rtarm stop` if need be.",
    on_the_way="The goal was sent; the arm needs about {duration:.1f} s.",
    no_answer="The goal was sent, and {seconds:g} s later the arm has not begun. It is cancelled, and ends at once "
    "should the ROS process come to it later: see Machine.",
    no_result="The arm has ended the goal, and {seconds:g} s later the ROS process has not said how: see Machine.",
    already="The arm stands there already: move a slider first.",
    plots="Plots",
    which_joint="Joint",
    all_joints="all joints",
    position_plot="Position °",
    error_plot="Error ° (measured − commanded)",
    lateness_plot="Wake-up lateness µs (worst of 0.1 s)",
    seconds="s",
    late="late",
    events="Events",
    nothing_yet="nothing yet",
    machine="Machine",
    cycles="cycles",
    cycles_told="{cycles} at {rate:g} Hz, up {uptime}",
    overruns="overruns",
    overruns_told="{all} since the start, {recent} in the {span}",
    lateness="lateness",
    cycle_time="cycle time",
    percentiles="p50 {p50:.0f}, p99 {p99:.0f}, worst {max:.0f} µs in the {span}",
    bus="bus",
    bus_told="load {load:.0%}, {sent:.0f} frames/s sent, {received:.0f} received",
    buses="buses",
    no_bus="no bus",
    bus_trouble="bus trouble",
    ros="ROS process",
    ros_none="none: the arm takes no goals",
    ros_told="pid {pid}",
    control="control",
    control_told="pid {pid}, {scheduling}",
    recording="A recording: it only shows.",
)

CHINESE = Words(
    language="zh",
    title="rtarm：{arm}",
    waiting="等待中",
    fit="可以运动",
    unfit="不能运动",
    held="已暂停",
    held_tag="等待“继续”",
    goal="目标：{stands}，速度 {scale:.0%}",
    no_goal="无",
    goal_of="{id} {phase}，{clock:.1f} / {duration:.1f} s",
    goal_endless="{id} {phase}，{clock:.1f} s",
    last_result="上一个目标（{id}）：{sentence}",
    no_geometry="机械臂文件没有 kinematics 一节，所以没有三维画面；其余功能照常。",
    hold="暂停",
    hold_hint="让机械臂在路径上停下，目标等待继续；按“继续”之前不接受新目标。这不是急停：急停是电源线上的开关。",
    resume="继续",
    resume_hint="暂停的目标继续执行：机械臂会动。被暂停或停止的机械臂重新接受目标。",
    stop="停止并结束目标",
    stop_hint="让机械臂在路径上停下并结束目标；按“继续”之前不接受任何目标，不论来自谁。这不是急停：急停是电源线上的开关。",
    clear_fault="清除故障",
    clear_fault_hint="排除原因之后：驱动器重新启动，机械臂保持在原处。",
    enable="使能驱动器 …",
    enable_hint="再次询问之后，驱动器使已松开的机械臂保持在原处。",
    enable_question="使能 {arm} 的驱动器？",
    enable_warning="驱动器将使机械臂保持在当前位置。手和物品请离开它的运动范围。",
    enable_yes="使能驱动器",
    reference="按读数确认关节位置 …",
    reference_hint="未建立参考点的关节：显示每个关节将被认为所在的位置，然后询问。什么都不会动。",
    reference_question="请看 {arm}，看两遍：各关节是否就在这些位置？之后的每个目标都会相信它。",
    stands_at="角度 °",
    reference_yes="就在这些位置",
    no="保持现状",
    speed="速度 %",
    speed_hint="让所有目标（不论来自谁）在路径上变慢；0 为静止。",
    joints="关节",
    joint="关节",
    measured="实测 °",
    commanded="指令 °",
    error="误差 °",
    near_lower="{joint} 距下限（{limit:g}°）{distance:.1f}°",
    near_upper="{joint} 距上限（{limit:g}°）{distance:.1f}°",
    beyond="{joint} 超出限位（{limit:g}°）{distance:.1f}°",
    gripper="夹爪：{does}",
    move="运动",
    move_help="拖动滑块：绿色的机械臂显示将要到达的位置。按下“前往”之前什么都不会动。这段路不做碰撞检测：请看着机械臂。",
    go="前往：机械臂将运动 {duration:.1f} s",
    go_nowhere="前往",
    go_hint="向机械臂的普通 action 发送一个目标，由它检查。正在运行的目标绝不会被替换。",
    back="滑块回到机械臂",
    back_hint="放弃所选位置；什么都不会动。",
    goal_runs="目标 {id} 正在运行，这里绝不替换正在运行的目标：请等它结束，或先停止它。",
    under_way="{what}：进行中 …",
    broken="{what}：页面的程序错误使其中断，详情见启动页面的终端。请看机械臂，必要时使用 `rtarm stop`。",
    on_the_way="目标已发送；机械臂大约需要 {duration:.1f} s。",
    no_answer="目标已发送，但 {seconds:g} s 之后机械臂仍未开始。"
    "目标已取消：ROS 进程以后处理到它时，它会立即结束。请看“机器”。",
    no_result="机械臂已结束目标，但 {seconds:g} s 之后 ROS 进程仍未说明结果：请看“机器”。",
    already="机械臂已经在那里：请先拖动滑块。",
    plots="曲线",
    which_joint="关节",
    all_joints="所有关节",
    position_plot="位置 °",
    error_plot="误差 °（实测 − 指令）",
    lateness_plot="唤醒延迟 µs（每 0.1 s 的最大值）",
    seconds="s",
    late="延迟",
    events="事件",
    nothing_yet="暂无",
    machine="机器",
    cycles="周期",
    cycles_told="{cycles}，{rate:g} Hz，已运行 {uptime}",
    overruns="漏掉",
    overruns_told="启动以来 {all}，{span} 内 {recent}",
    lateness="唤醒延迟",
    cycle_time="周期用时",
    percentiles="p50 {p50:.0f}，p99 {p99:.0f}，最大 {max:.0f} µs（{span}）",
    bus="总线",
    bus_told="负载 {load:.0%}，每秒发送 {sent:.0f} 帧，接收 {received:.0f} 帧",
    buses="各总线",
    no_bus="没有总线",
    bus_trouble="总线异常",
    ros="ROS 进程",
    ros_none="没有：机械臂不接受目标",
    ros_told="pid {pid}",
    control="控制进程",
    control_told="pid {pid}，{scheduling}",
    recording="这是一段记录：只能观看。",
)

WORDS: dict[Language, Words] = {"en": ENGLISH, "zh": CHINESE}
